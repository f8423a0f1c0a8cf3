"""What `octarm tune` does."""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import functools
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from controllers import CONTROLLERS, make_controller
from controllers.gain_sets import GainSet, shortest
from octarm.arm.nominal import LagrangeModel
from octarm.arm.parameters import ArmParameters
from octarm.bars import bar as new_bar
from octarm.commands.many_runs import TuneOptions
from octarm.commands.options import GainOptions, spelt
from octarm.declared import Code, lacking, short_name
from octarm.disturbances.spelling import parse_disturbance
from octarm.errors import OctarmError, printable
from octarm.files import write_text
from octarm.interfaces import Tunable
from octarm.simulation.engines import MUJOCO, usual_engine
from octarm.sweeps.scenarios import Scenario
from octarm.sweeps.tune import (
    Budget,
    Costs,
    SearchState,
    Space,
    StateFile,
    Tuned,
    settings,
    versions,
)
from octarm.sweeps.tune import tune as tune_gains
from octarm.sweeps.tune_cost import FORMULA, LARGEST, Examination, Rig
from octarm.sweeps.workers import WorkerProcesses, cores


def tune(controller: str, options: TuneOptions) -> None:
    """`octarm tune`: gains for one controller, as a TOML file."""
    assert options.out is not None
    out, budget, rig = options.out, Budget.within(options.budget), _rig(options)
    rig.check()
    if misses := lacking(CONTROLLERS[controller], knobs=[], scales=[]):
        raise OctarmError(
            f"{short_name(controller)} {misses}; a controllers.law.Law has it, and "
            "octarm.interfaces.Tunable says what it answers"
        )
    if options.force and not options.resume:
        state_file(out).unlink(missing_ok=True)
    tuned = _search(controller, out, budget, rig, options)
    origin = {
        "command": _command(controller, options),
        "date": datetime.date.today(),
        "seed": options.seed,
        "budget": options.budget,
        **rig.settings(),
    }
    name, code, start = short_name(controller), CONTROLLERS.code(controller), _start(options)
    write_text(out, gain_set(name, rig.arm(), origin, budget, tuned, code, start).to_toml())
    state_file(out).unlink(missing_ok=True)
    _print_summary(name, budget, tuned, start)
    print(f"wrote {printable(str(out))}")
    gains, word = (printable(shlex.quote(str(each))) for each in (out, controller))
    print(f"try it: octarm run --controller {word} --gains {gains}")


def _rig(options: TuneOptions) -> Rig:
    """What gains are tried on."""
    model = options.model
    given = model.arm is not None or model.parameter
    return Rig(
        options.engine or usual_engine(),
        model.plant_modules,
        model.layout,
        model.sensing,
        model.true_arm() if given else None,
        options.reference,
        tuple(map(parse_disturbance, options.disturbance)),
        model.mismatch,
        model.factors(),
    )


def _start(options: TuneOptions) -> str:
    """What the gains are called that the search begins around."""
    return "recommended" if options.gain_options == GainOptions() else "start"


def _with_gains(
    controller: str, gain_set: str, begun: Mapping[str, Any], nominal: Any, gains: Mapping[str, Any]
) -> Tunable:
    """A controller with these gains, and those given not as at first."""
    return make_controller(controller, nominal, {**begun, **gains}, gain_set=gain_set)


def _command(controller: str, options: TuneOptions, *more: str) -> str:
    """The command line that finds the same gains."""
    words = ["--budget", f"{options.budget:g}", "--seed", str(options.seed)]
    words += spelt(options, "out", "resume", "force", "workers", "budget", "seed")
    return shlex.join(["octarm", "tune", controller, *words, *more])


def _search(controller: str, out: Path, budget: Budget, rig: Rig, options: TuneOptions) -> Tuned:
    """The search, with a bar on its progress and its state on disk."""
    gains, nominal = options.gain_options, rig.arm()
    begun = gains.gains or "recommended", gains.values()
    factory = functools.partial(_with_gains, controller, *begun)
    space = Space(factory(nominal, {}), nominal.modules)
    depends_on = settings(controller, space, budget, options.seed, rig)
    code = CONTROLLERS.code(controller)
    depends_on |= {} if code is None else {"code": code.sha256}
    file = StateFile(state_file(out), depends_on)
    if file.path.exists() and not options.resume:
        raise OctarmError(
            f"{file.path} keeps a search that was interrupted; go on with it by --resume, or "
            "begin it anew by --force"
        )
    state = file.read() if options.resume else None
    workers = options.workers or cores()
    pool = WorkerProcesses(workers) if workers > 1 else contextlib.nullcontext()
    bar = new_bar(total=budget.seconds, unit=" simulated s", unit_scale=True)

    def keep(state: SearchState) -> None:
        file.write(state)
        bar.set_postfix_str(f"generation {state.generation + 1}, cost {state.costs[0]:.4g}")

    try:
        with bar, pool as processes:
            return tune_gains(
                factory,
                budget,
                seed=options.seed,
                state=state,
                keep=keep,
                progress=bar.update,
                rig=rig,
                workers=processes,
            )
    except KeyboardInterrupt:
        if not file.path.exists():
            raise KeyboardInterrupt("nothing was written") from None
        again = _command(controller, options, f"--out={out}", "--resume")
        raise KeyboardInterrupt(f"go on by: {again}") from None


def state_file(out: Path) -> Path:
    """Where the state of the search is kept that ends in a file."""
    return out.with_name(out.name + ".state")


def gain_set(
    controller: str,
    arm: ArmParameters,
    origin: Mapping[str, Any],
    budget: Budget,
    tuned: Tuned,
    code: Code | None = None,
    start: str = "recommended",
) -> GainSet:
    """The result, with all that is needed to find it again.

    `code` is where a controller comes from that is not built in, `start` what the gains are called
    that the search began around.
    """
    tuning = {
        **origin,
        "candidates": budget.generations * budget.population,
        "simulated_seconds": budget.seconds,
        "objective": FORMULA,
        "selection": f"the best of the last generation's best {budget.finalists} and the "
        f"{start} gains in the long trial, on {MUJOCO}",
        "at_bounds": tuned.at_bounds,
    }
    return GainSet.model_validate(
        {
            "controller": controller,
            "gains": {name: shortest(gain) for name, gain in tuned.gains.items()},
            "arm": _described(arm, budget),
            "tuning": tuning,
            **({} if code is None else {"code": code.model_dump()}),
            "versions": versions(),
            "search": _outcome(budget.short, tuned.short, start),
            "long_trial": _outcome(budget.long, tuned.long, start),
            "evaluation": _outcome(budget.unseen, tuned.unseen, start),
        }
    )


def _described(arm: ArmParameters, budget: Budget) -> dict[str, float]:
    """The arm that gains are tuned for, and the longest control period, in its time scale."""
    model = LagrangeModel(arm)
    longest = max(scenario.period for scenario in budget.short.scenarios)
    numbers = {**model.descriptors, "control_period": longest / model.time_scale}
    return {name: float(f"{float(x):.4g}") for name, x in numbers.items()}


def _outcome(examination: Examination, costs: Costs, start: str) -> dict[str, Any]:
    """What the gains cost, in all and in each scenario."""
    rows = [
        {**_unusual(scenario), "cost": cost, start: other}
        for scenario, cost, other in zip(
            examination.scenarios, costs.tuned.tolist(), costs.by_hand.tolist(), strict=True
        )
    ]
    return {
        "cost": examination.mean(costs.tuned).item(),
        start: examination.mean(costs.by_hand).item(),
        "measured_from": examination.begin,
        "duration": examination.duration,
        "scenarios": rows,
    }


def _print_summary(controller: str, budget: Budget, tuned: Tuned, start: str) -> None:
    print(
        f"{controller}: {budget.generations * budget.population} candidates in "
        f"{budget.search_seconds:.0f} simulated s; the last trials, on {MUJOCO}, took "
        f"{budget.seconds - budget.search_seconds:.0f} s more"
    )
    print(f"  cost                     tuned  {start:>11}")
    for name, trial, costs in (
        ("search", budget.short, tuned.short),
        ("long trial", budget.long, tuned.long),
        ("unseen", budget.unseen, tuned.unseen),
    ):
        means = f"{trial.mean(costs.tuned):>11.5f} {trial.mean(costs.by_hand):>12.5f}"
        print(f"  {name:<10} of {trial.duration:>4g} s {means}")
    for scenario, cost in zip(budget.long.scenarios, tuned.long.tuned, strict=True):
        if cost >= LARGEST:
            print(f"  lost: {', '.join(f'{name} {x}' for name, x in _unusual(scenario).items())}")
    if tuned.at_bounds:
        print(f"  as small or large as allowed: {', '.join(tuned.at_bounds)}")


def _unusual(scenario: Scenario) -> dict[str, Any]:
    """What of a scenario is not as usual, and its reference, by the names of its fields."""
    usual = dataclasses.asdict(Scenario(reference=""))
    return {name: x for name, x in dataclasses.asdict(scenario).items() if x != usual[name]}

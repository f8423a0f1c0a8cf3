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
from octarm.bars import bar as new_bar
from octarm.commands.many_runs import TuneOptions
from octarm.commands.options import GainOptions, spelt
from octarm.declared import lacking, short_name
from octarm.disturbances.spelling import parse_disturbance
from octarm.errors import OctarmError, printable
from octarm.files import write_text
from octarm.interfaces import Tunable
from octarm.simulation.engines import MUJOCO, usual_engine
from octarm.sweeps.scenarios import Examination, Scenario
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
from octarm.sweeps.tune_cost import FORMULA, LARGEST, Rig
from octarm.sweeps.workers import WorkerProcesses, cores


def tune(controller: str, options: TuneOptions) -> None:
    """`octarm tune`: gains for one controller, as a TOML file."""
    assert options.out is not None
    out, model, name = options.out, options.model, short_name(controller)
    budget = Budget.within(options.budget)
    rig = Rig(
        engine=options.engine or usual_engine(),
        plant_modules=model.plant_modules,
        layout=model.layout,
        sensing=model.sensing,
        parameters=model.true_arm() if model.arm is not None or model.parameter else None,
        reference=options.reference,
        disturbances=tuple(map(parse_disturbance, options.disturbance)),
        mismatch=model.mismatch,
        nominal=model.factors(),
    )
    rig.check()
    if misses := lacking(CONTROLLERS[controller], knobs=[], scales=[]):
        raise OctarmError(
            f"{name} {misses}; a controllers.law.Law has it, and octarm.interfaces.Tunable says "
            "what it answers"
        )
    state = out.with_name(out.name + ".state")  # of a search that has not ended
    tuned = _search(controller, state, budget, rig, options)
    start = "recommended" if options.gain_options == GainOptions() else "start"
    write_text(out, _gain_set(controller, options, rig, budget, tuned, start).to_toml())
    state.unlink(missing_ok=True)
    _print_summary(name, budget, tuned, start)
    print(f"wrote {printable(str(out))}")
    gains, word = (printable(shlex.quote(str(each))) for each in (out, controller))
    print(f"try it: octarm run --controller {word} --gains {gains}")


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


def _search(controller: str, path: Path, budget: Budget, rig: Rig, options: TuneOptions) -> Tuned:
    """The search, with a bar on its progress and its state on disk."""
    gains, nominal = options.gain_options, rig.arm()
    begun = gains.gains or "recommended", gains.values()
    factory = functools.partial(_with_gains, controller, *begun)
    space = Space(factory(nominal, {}), nominal.modules)
    depends_on = settings(controller, space, budget, options.seed, rig)
    code = CONTROLLERS.code(controller)
    depends_on |= {} if code is None else {"code": code.sha256}
    file = StateFile(path, depends_on)
    state = file.read() if options.resume else None
    if options.force and not options.resume:
        path.unlink(missing_ok=True)
    elif path.exists() and not options.resume:
        raise OctarmError(
            f"{path} keeps a search that was interrupted; go on with it by --resume, or "
            "begin it anew by --force"
        )
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
        if not path.exists():
            raise KeyboardInterrupt("nothing was written") from None
        again = _command(controller, options, f"--out={options.out}", "--resume")
        raise KeyboardInterrupt(f"go on by: {again}") from None


def _gain_set(
    controller: str, options: TuneOptions, rig: Rig, budget: Budget, tuned: Tuned, start: str
) -> GainSet:
    """The result, with all that is needed to find it again.

    `start` is what the gains are called that the search began around.
    """
    model, code = LagrangeModel(rig.arm()), CONTROLLERS.code(controller)
    longest = max(scenario.period for scenario in budget.short.scenarios)
    arm = {**model.descriptors, "control_period": longest / model.time_scale}
    return GainSet.model_validate(
        {
            "controller": short_name(controller),
            "gains": {name: shortest(gain) for name, gain in tuned.gains.items()},
            "arm": {name: float(f"{float(x):.4g}") for name, x in arm.items()},
            "tuning": {
                "command": _command(controller, options),
                "date": datetime.date.today(),
                "seed": options.seed,
                "budget": options.budget,
                **rig.settings(),
                "candidates": budget.generations * budget.population,
                "simulated_seconds": budget.seconds,
                "objective": FORMULA,
                "selection": f"the best of the last generation's best {budget.finalists} and the "
                f"{start} gains in the long trial, on {MUJOCO}",
                "at_bounds": tuned.at_bounds,
            },
            **({} if code is None else {"code": code.model_dump()}),
            "versions": versions(),
            "search": _outcome(budget.short, tuned.short, start),
            "long_trial": _outcome(budget.long, tuned.long, start),
            "evaluation": _outcome(budget.unseen, tuned.unseen, start),
        }
    )


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

"""What `octarm tune` does."""

from __future__ import annotations

import dataclasses
import datetime
import functools
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from controllers import make_controller
from controllers.gain_sets import GainSet, shortest
from octarm.arm.file import read_arm
from octarm.errors import ExitCode, OctarmError, printable
from octarm.files import write_text
from octarm.simulation.engines import usual_engine
from octarm.sweeps.tune import Budget, SearchState, Space, StateFile, Tuned, settings, versions
from octarm.sweeps.tune import tune as tune_gains
from octarm.sweeps.tune_cost import FORMULA, Examination, Rig


@dataclasses.dataclass(frozen=True)
class Options:
    """What `octarm tune` is given besides the controller, as the command line has it."""

    out: Path
    seconds: float
    seed: int
    resume: bool
    force: bool
    engine: str | None
    arm: str | None
    plant_modules: int | None
    layout: str

    @property
    def rig(self) -> Rig:
        """What gains are tried on."""
        engine = usual_engine() if self.engine is None else self.engine
        arm = None if self.arm is None else read_arm(self.arm)
        return Rig(engine, self.plant_modules, self.layout, arm)

    def command(self, controller: str) -> str:
        """The command line that finds the same gains."""
        words = ["octarm", "tune", controller, "--budget", f"{self.seconds:g}"]
        words += ["--seed", str(self.seed)]
        words += ["--engine", self.engine] if self.engine is not None else []
        words += ["--arm", self.arm] if self.arm is not None else []
        if self.plant_modules is not None:
            words += ["--plant-modules", str(self.plant_modules), "--layout", self.layout]
        return shlex.join(words)


def tune(controller: str, options: Options) -> int:
    """`octarm tune`: gains for one controller, as a TOML file."""
    out, budget, rig = options.out, Budget.within(options.seconds), options.rig
    rig.check()
    if options.force and not options.resume:
        state_file(out).unlink(missing_ok=True)
    tuned = _search(controller, budget, options)
    origin = {
        "command": options.command(controller),
        "date": datetime.date.today(),
        "seed": options.seed,
        "budget": options.seconds,
        **rig.settings(),
    }
    write_text(out, gain_set(controller, rig.arm().modules, origin, budget, tuned).to_toml())
    state_file(out).unlink(missing_ok=True)
    _print_summary(controller, budget, tuned)
    print(f"wrote {printable(str(out))}")
    gains = printable(shlex.quote(str(out)))
    print(f"try it: octarm run --controller {controller} --gains {gains}")
    return ExitCode.FINE


def _search(controller: str, budget: Budget, options: Options) -> Tuned:
    """The search, with a bar on its progress and its state on disk."""
    out, resume = options.out, options.resume
    factory = functools.partial(make_controller, controller, gain_set="recommended")
    nominal = options.rig.arm()
    space = Space(factory(nominal), nominal.modules)
    depends_on = settings(controller, space, budget, options.seed, options.rig)
    file = StateFile(state_file(out), depends_on)
    if file.path.exists() and not resume:
        raise OctarmError(
            f"{file.path} keeps a search that was interrupted; go on with it by --resume, or "
            "begin it anew by --force"
        )
    state = file.read() if resume else None
    bar = tqdm(
        total=budget.seconds, unit=" simulated s", unit_scale=True, disable=None, leave=False
    )

    def keep(state: SearchState) -> None:
        file.write(state)
        bar.set_postfix_str(f"generation {state.generation + 1}, cost {state.costs[0]:.4g}")

    try:
        with bar:
            return tune_gains(
                factory,
                budget,
                seed=options.seed,
                state=state,
                keep=keep,
                progress=bar.update,
                rig=options.rig,
            )
    except KeyboardInterrupt:
        if not file.path.exists():
            raise KeyboardInterrupt("nothing was written") from None
        more = shlex.join(["--out", str(out), "--resume"])
        raise KeyboardInterrupt(f"go on by: {options.command(controller)} {more}") from None


def state_file(out: Path) -> Path:
    """Where the state of the search is kept that ends in a file."""
    return out.with_name(out.name + ".state")


def gain_set(
    controller: str, modules: int, origin: Mapping[str, Any], budget: Budget, tuned: Tuned
) -> GainSet:
    """The result, with all that is needed to find it again."""
    tuning = {
        **origin,
        "candidates": budget.generations * budget.population,
        "simulated_seconds": budget.seconds,
        "objective": FORMULA,
        "selection": f"the best of the last generation's best {budget.finalists} and the "
        "recommended gains in the long trial",
        "at_bounds": tuned.at_bounds,
    }
    return GainSet.model_validate(
        {
            "controller": controller,
            "modules": modules,
            "gains": {name: shortest(gain) for name, gain in tuned.gains.items()},
            "tuning": tuning,
            "versions": versions(),
            "search": _outcome(budget.short, tuned.short, tuned.short_by_hand),
            "long_trial": _outcome(budget.long, tuned.long, tuned.long_by_hand),
        }
    )


def _outcome(examination: Examination, tuned: np.ndarray, by_hand: np.ndarray) -> dict[str, Any]:
    """What the gains cost, in all and in each scenario."""
    rows = [
        {**dataclasses.asdict(scenario), "cost": cost, "recommended": other}
        for scenario, cost, other in zip(
            examination.scenarios, tuned.tolist(), by_hand.tolist(), strict=True
        )
    ]
    return {
        "cost": tuned.mean().item(),
        "recommended": by_hand.mean().item(),
        "measured_from": examination.begin,
        "duration": examination.duration,
        "scenarios": rows,
    }


def _print_summary(controller: str, budget: Budget, tuned: Tuned) -> None:
    print(
        f"{controller}: {budget.generations * budget.population} candidates, "
        f"{budget.seconds:.0f} simulated s"
    )
    print("  cost                     tuned  recommended")
    for name, duration, cost, other in (
        ("search", budget.short.duration, tuned.short, tuned.short_by_hand),
        ("long trial", budget.long.duration, tuned.long, tuned.long_by_hand),
    ):
        print(f"  {name:<10} of {duration:>4g} s {cost.mean():>11.5f} {other.mean():>12.5f}")
    if tuned.at_bounds:
        print(f"  as small or large as allowed: {', '.join(tuned.at_bounds)}")

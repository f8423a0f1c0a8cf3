"""Whether an episode of a sweep comes out again when it is run alone."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from octarm.checks.differences import Comparison, Difference, compare, listed, origin
from octarm.interfaces import ControllerFactory
from octarm.runs import folder as runs
from octarm.runs.versions import host, versions
from octarm.sweeps import engine_check
from octarm.sweeps.episodes import FinishedSweep, first_difference
from octarm.sweeps.plan import Plan
from octarm.sweeps.shards import run_arms
from octarm.sweeps.store import RECORDED, origin_of


@dataclasses.dataclass(frozen=True, kw_only=True)
class EpisodeCheck(Comparison):
    """A row of a sweep's table compared with that of the episode run alone.

    Differences are those of the columns, the checkpoints aside.

    Attributes:
        label: what the episode is, in words.
        between: the instants between which the motion parts [s]; None if it does not.
        gains: of the controller for the nominal arm, where they are not what they were.
        recorded: run folder of the episode, if there is one.
    """

    episode: int
    label: str
    between: tuple[float, float] | None
    gains: tuple[Difference, ...]
    recorded: Path | None

    @property
    def identical(self) -> bool:  # noqa: D102
        return self.between is None and not self.differences and not self.gains

    def lines(self) -> list[str]:  # noqa: D102
        head = f"episode {self.episode} ({self.label})"
        if self.identical:
            same = f"{head}: identical when run alone: digest, checkpoints and all measures"
            return [same, *self.harmless_changes()]
        if self.between is None:
            lines = [f"{head}: the motion is the same, but not what the table says of it"]
        else:
            begin, end = self.between
            lines = [f"{head}: different from an instant between t = {begin:g} s and {end:g} s on"]
            if self.recorded is not None:
                lines.append(f"  octarm verify {self.recorded} says from which one on")
        lines += [*listed(self.differences, "column"), *listed(self.gains, "gain")]
        return [*lines, *self.origins()]


def check_episode(sweep: FinishedSweep, episode: int, factory: ControllerFactory) -> EpisodeCheck:
    """Runs an episode of a sweep alone, and compares; the factory is the one that the sweep had.

    Raises OctarmError if the episode is not there, or cannot be made again.
    """
    row = sweep.row(episode)
    (stored,) = row.to_pylist()
    arms, spec = sweep.plan.episode(episode), sweep.plan.spec
    (again,) = run_arms(sweep.plan, arms, factory).to_pylist()
    was, now = (values.pop("checkpoints") for values in (stored, again))
    for values in (stored, again):  # that an episode alone does not show again
        values.pop(engine_check.COLUMN, None)
    spec = sweep.plan.spec
    controller = spec.controller(arms.controller, spec.all_arms()[0], factory)
    gains = runs.gains_of(controller)
    return EpisodeCheck(
        episode=episode,
        label=_label(sweep.plan, episode),
        between=first_difference(was, now, sweep.plan.spec.duration),
        differences=tuple(compare(stored, again, ["wall_time"])),
        gains=tuple(compare(sweep.gains.get(arms.controller, {}), gains)),
        recorded=next(iter((sweep.path / RECORDED).glob(f"{episode}-*")), None),
        then=origin(origin_of(row)),
        now=origin({"versions": versions(spec.engine, spec.code), "host": host()}),
    )


def _label(plan: Plan, episode: int) -> str:
    """What an episode is, in words."""
    number = np.array([episode])
    values = {name: column[0] for name, column in plan.values(number).items()}
    words = [str(values.pop(name)) for name in ("controller", "reference")]
    for name, value in values.items():
        words.append(f"{name} {value}" if isinstance(value, str) else f"{name} {value:g}")
    return ", ".join([*words, f"seed {plan.seeds(number)[0]}"])

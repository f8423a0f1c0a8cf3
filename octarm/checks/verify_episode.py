"""Whether an episode of a sweep comes out again when it is run alone."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa

from octarm.arm.mjcf import nominal_parameters
from octarm.checks.differences import Difference, beside, compare, despite, flat, told
from octarm.errors import OctarmError
from octarm.runs import folder as runs
from octarm.runs.digest import CHECKPOINTS
from octarm.runs.experiment import Factory
from octarm.runs.versions import host, versions
from octarm.sweeps.folder import RECORDED, SPEC, read_manifest, read_row
from octarm.sweeps.gain_sets import of_sets
from octarm.sweeps.parser import read_spec
from octarm.sweeps.plan import Plan
from octarm.sweeps.shard_file import labels_of
from octarm.sweeps.shards import run_arms


@dataclasses.dataclass(frozen=True, kw_only=True)
class EpisodeCheck:
    """A row of a sweep's table beside that of the episode run alone.

    Attributes:
        episode: its number.
        label: what it is, in words.
        between: the instants between which the motion becomes another one [s]; None if it does
            not.
        differences: of the columns, the checkpoints aside.
        gains: of the controller for the nominal arm, where they are not what they were.
        recorded: run folder of the episode, if there is one.
        then: versions and machine that the row comes from.
        now: those of the re-run.
    """

    episode: int
    label: str
    between: tuple[float, float] | None
    differences: tuple[Difference, ...]
    gains: tuple[Difference, ...]
    recorded: Path | None
    then: Mapping[str, str]
    now: Mapping[str, str]

    @property
    def identical(self) -> bool:
        """Whether everything came out again."""
        return self.between is None and not self.differences

    def lines(self) -> list[str]:
        """What was found, for the terminal."""
        head = f"episode {self.episode} ({self.label})"
        if self.identical:
            said = f"{head}: identical when run alone: digest, checkpoints and all measures"
            return [said, *despite(self.then, self.now)]
        if self.between is None:
            found = [f"{head}: the motion is the same, but not what the table says of it"]
        else:
            begin, end = self.between
            found = [f"{head}: different from an instant between t = {begin:g} s and {end:g} s on"]
            if self.recorded is not None:
                found.append(f"  octarm verify {self.recorded} says from which one on")
        found += told(self.differences, "column") if self.differences else []
        found += told(self.gains, "gain") if self.gains else []
        return [*found, *beside(self.then, self.now)]


class FinishedSweep:
    """A sweep folder, whose episodes can be run again one by one.

    Attributes:
        path: the folder.
        plan: of its episodes.
    """

    def __init__(self, path: Path) -> None:
        """Reads what was run.

        Raises:
            ValueError: if the folder holds no sweep, or its spec was changed.
            OSError: if the spec cannot be read.
        """
        self.path = path
        self._manifest = read_manifest(path)
        self.plan = Plan(read_spec(path / SPEC))
        if self.plan.spec.hash() != self._manifest["spec_hash"]:
            raise OctarmError(f"{path / SPEC} was changed: it is not what the sweep was run with")

    def finished(self) -> np.ndarray:
        """The numbers of the episodes that are there, shape (n,)."""
        ranges: list[np.ndarray] = [
            np.arange(shard["first"], shard["first"] + shard["episodes"])
            for shard in self._manifest["shards"]
            if (self.path / shard["file"]).is_file()
        ]
        return np.concatenate([np.empty(0, dtype=np.int64), *ranges])

    def row(self, episode: int) -> pa.Table:
        """The row of an episode.

        Raises:
            ValueError: if there is none, or it is damaged.
        """
        self.plan.episode(episode)  # raises when there is no such episode
        return read_row(self.path, episode)

    def check(self, episode: int, factory: Factory) -> EpisodeCheck:
        """Runs an episode alone, and compares.

        Args:
            episode: number.
            factory: of the controllers, the one that the sweep had.

        Raises:
            ValueError: if the episode is not there, or cannot be made again.
        """
        row = self.row(episode)
        (stored,) = row.to_pylist()
        arms = self.plan.episode(episode)
        factory = of_sets(factory, self.plan.spec)
        again = run_arms(self.plan, arms, factory).to_pylist()[0]
        was, now = (row.pop("checkpoints") for row in (stored, again))
        del stored["wall_time"]
        own = self.plan.spec.gains.get(arms.controller, {})
        gains = runs.gains_of(factory(arms.controller, nominal_parameters(), own))
        return EpisodeCheck(
            episode=episode,
            label=self._label(episode),
            between=first_difference(was, now, self.plan.spec.duration),
            differences=tuple(compare(stored, again)),
            gains=tuple(compare(self._manifest["gains"].get(arms.controller, {}), gains)),
            recorded=next(iter((self.path / RECORDED).glob(f"{episode}-*")), None),
            then=flat(labels_of(row)),
            now=flat({"versions": versions(), "host": host()}),
        )

    def _label(self, episode: int) -> str:
        number = np.array([episode])
        values = {name: column[0] for name, column in self.plan.values(number).items()}
        words = [str(values.pop(name)) for name in ("controller", "reference")]
        words += [
            f"{name} {value}" if isinstance(value, str) else f"{name} {value:g}"
            for name, value in values.items()
        ]
        return ", ".join([*words, f"seed {self.plan.seeds(number)[0]}"])


def first_difference(was: list[int], now: list[int], duration: float) -> tuple[float, float] | None:
    """Between which instants [s] two motions part; None if they do not.

    Args:
        was: checkpoints of one of them, see `octarm.runs.digest.StateDigest`.
        now: of the other one.
        duration: of both [s].
    """
    for k, pair in enumerate(zip(was, now, strict=True)):
        if pair[0] != pair[1]:
            return duration * k / CHECKPOINTS, duration * (k + 1) / CHECKPOINTS
    return None

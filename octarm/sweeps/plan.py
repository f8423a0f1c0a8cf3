"""The episodes of a sweep, how they are counted, and which of them are stepped together.

All of them share one physics step, so that controllers and cells are compared alike. It is looked
at before any of them is run: an episode whose arm is too stiff for it would diverge, whatever the
controller.
"""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import numpy as np
import numpy.typing as npt

from octarm.disturbances.episode import Disturbance, PlantChange
from octarm.disturbances.streams import stream
from octarm.errors import OctarmError
from octarm.fields import Amount, Quantity, field_kinds
from octarm.memory import check_memory
from octarm.simulation.setup import Setup
from octarm.simulation.steps import AUTO, Possible, StepError, fitting_step
from octarm.sweeps.spec import ARM, PLANT, SETTINGS, SweepSpec

_MOST_EPISODES = 10**15
_MOST_SHARDS = 100_000


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class EpisodeArms(Setup):
    """All that makes episodes what they are: of arms that share a batch, or of one arm alone.

    See `octarm.load` for what is not said here.

    Attributes:
        episodes: their numbers, shape (n,).
        batch: n; None for one arm alone.
        mismatch: of the nominal model, shape () or (n,) [1].
        arm: name of the arm; empty for the nominal one.
    """

    episodes: np.ndarray
    batch: int | None
    controller: str
    mismatch: Amount
    seeds: list[np.random.SeedSequence]
    arm: str = ""


class Plan:
    """Numbers for episodes and shards.

    Episode numbers count through the grid, the first axis slowest and the seeds fastest. A shard is
    a run of numbers with the same controller, reference, plant and words, which share a batch. The
    partition depends on the spec alone.

    Attributes:
        episodes: number of episodes.
        shards: their numbers.
        pieces: shards, as equal as they can be, of all that may share a batch.
    """

    def __init__(self, spec: SweepSpec) -> None:
        """The plan of a sweep."""
        self.spec = spec
        self._shape = (*(len(axis.values) for axis in spec.axes), spec.episodes)
        self.episodes = math.prod(self._shape)
        if self.episodes > _MOST_EPISODES:
            raise OctarmError(
                f"the sweep has {self.episodes} episodes; it must be at most {_MOST_EPISODES}, "
                "so that their numbers are exact"
            )
        apart = math.prod(len(axis.values) for axis in spec.axes if axis.apart)
        self._together = self.episodes // apart  # axes that keep batches apart come first
        self.pieces = -(-self._together // spec.batch)
        self.shards = range(apart * self.pieces)
        self._known, self._draws = 0, dict[str, np.ndarray]()

    def shard(self, number: int) -> range:
        """The episodes of a shard."""
        group, piece = divmod(self.shards[number], self.pieces)
        begin, end = (self._together * i // self.pieces for i in (piece, piece + 1))
        return range(group * self._together + begin, group * self._together + end)

    def check_size(self) -> None:
        """Raises OctarmError for a sweep of more shards than a manifest should list."""
        if len(self.shards) > _MOST_SHARDS:
            raise OctarmError(
                f"the sweep has {len(self.shards)} shards; it must have at most {_MOST_SHARDS}, "
                "which its manifest lists one by one: choose a larger batch, or several sweeps"
            )

    def seeds(self, episodes: np.ndarray) -> np.ndarray:
        """Which of the seeds 0, 1, ... episodes have, shape (n,)."""
        return episodes % self.spec.episodes

    def values(self, episodes: np.ndarray) -> dict[str, np.ndarray]:
        """The values of all axes by name, each of shape (n,)."""
        places = np.unravel_index(episodes, self._shape)
        gridded = {
            axis.name: np.array(axis.values)[place]
            for axis, place in zip(self.spec.axes, places, strict=False)
        }
        seeds = self.seeds(episodes)
        drawn = self._drawn(int(seeds.max()) + 1) if self.spec.random else {}
        return gridded | {name: column[seeds] for name, column in drawn.items()}

    def arms(self, episodes: npt.ArrayLike) -> EpisodeArms:
        """Episodes of one shard, given by their numbers, shape (n,)."""
        numbers, spec = np.asarray(episodes), self.spec
        values = {name: _common(column) for name, column in self.values(numbers).items()}
        alike = [field.name for field in dataclasses.fields(Setup) if field.name in SETTINGS]
        arm = values.get(ARM, "")
        return EpisodeArms(
            episodes=numbers,
            batch=len(numbers),
            controller=values["controller"],
            reference=values["reference"],
            mismatch=values["mismatch"],
            disturbances=self._disturbances(values),
            seeds=[
                np.random.SeedSequence(spec.seed, spawn_key=(i,))
                for i in self.seeds(numbers).tolist()
            ],
            arm=arm,
            parameters=spec.arm(arm),
            **{name: getattr(spec, name) for name in alike},
            **{name: values[name] for name in PLANT if name in values},
        )

    def episode(self, number: int) -> EpisodeArms:
        """One episode, to be run alone; raises OctarmError if there is none of this number."""
        if not 0 <= number < self.episodes:
            raise OctarmError(
                f"there is no episode {number}; they are numbered 0 .. {self.episodes - 1}"
            )
        return dataclasses.replace(self.arms([number]), batch=None)

    def probes(self) -> list[np.ndarray]:
        """Episodes in which every value of every axis occurs, shape (n,) for each shared batch.

        Of seeds and drawn values it is a few.
        """
        apart = [len(axis.values) for axis in self.spec.axes if axis.apart]
        shared = self._shape[len(apart) : -1]
        few = min(64, self.spec.episodes) if self.spec.random else 1
        count = np.arange(max(few, *shared))
        turning = [count % length for length in (*shared, self.spec.episodes)]
        return [
            np.ravel_multi_index((*(np.full_like(count, i) for i in group), *turning), self._shape)
            for group in np.ndindex(*apart)
        ]

    def _disturbances(self, values: dict[str, Any]) -> tuple[Disturbance, ...]:
        fields = {name: dict(self.spec.fixed.get(name, {})) for name in self.spec.disturbances}
        for axis in (*self.spec.axes, *self.spec.random):
            if axis.disturbance:
                kind = field_kinds(self.spec.class_of(axis.disturbance))[axis.field]
                value = values[axis.name]
                spread = isinstance(kind, Quantity) and kind.each and np.ndim(value) > 0
                fields[axis.disturbance][axis.field] = value[:, None] if spread else value
        return tuple(self.spec.class_of(name)(**given) for name, given in fields.items())

    def _drawn(self, seeds: int) -> dict[str, np.ndarray]:
        """The values of the random axes for at least so many seeds, the first ones.

        Those of a seed do not depend on the number of seeds.
        """
        if seeds > self._known:
            self._known = min(self.spec.episodes, 1 << (seeds - 1).bit_length())
            self._draws = self._draw(self._known)
        return self._draws

    def _draw(self, count: int) -> dict[str, np.ndarray]:
        spec = self.spec
        check_memory(2.0 * 8.0 * count * len(spec.random), f"{count} seeds of what is drawn")
        sobol = [axis for axis in spec.random if axis.method == "sobol"]
        spread = np.empty(0)
        if sobol:
            from scipy.stats import qmc  # takes half a second to import

            points = qmc.Sobol(len(sobol), scramble=False)
            spread = points.random_base2((count - 1).bit_length())
        drawn: dict[str, np.ndarray] = {}
        for axis in spec.random:
            draw = stream(np.random.SeedSequence(spec.seed), f"axis {axis.name}")
            if axis.method == "sobol":  # turned as a whole: every seed of the sweep has its own
                share = (spread[:count, sobol.index(axis)] + draw.random()) % 1.0
            else:
                share = draw.random(count)
            low, high = map(float, axis.values)
            drawn[axis.name] = np.minimum(low + share * (high - low), high)
        return drawn


def _common(column: np.ndarray) -> Any:
    """The value that all arms have, or the column when they differ."""
    return column[0].item() if np.all(column == column[0]) else column


def with_step(spec: SweepSpec, *, probes: bool = False) -> SweepSpec:
    """The spec, whose physics step suits all of its arms; `auto` has become a number.

    With `probes` a few episodes are looked at, in which every value of every axis occurs. Raises
    OctarmError if the step is too long for an arm; the sentence names its episode.
    """
    plan = Plan(spec)
    alike = len(spec.controllers) * len(spec.references)  # in which the step is the same
    first = range(len(plan.shards) // alike)
    if not any(issubclass(spec.class_of(name), PlantChange) for name in spec.disturbances):
        looked_at = [plan.shard(i)[:1] for i in first[:: plan.pieces]]  # a plant's arms are alike
    else:
        looked_at = plan.probes() if probes else map(plan.shard, first)
    longest = min(_longest(spec, plan.arms(episodes)) for episodes in looked_at)
    if spec.timestep != AUTO:
        return spec
    step, period = fitting_step(longest, spec.control_period)
    return dataclasses.replace(spec, timestep=step, control_period=period)


def _longest(spec: SweepSpec, arms: EpisodeArms) -> float:
    """The longest stable step of some arms [s], or infinity for a given step that suits them."""
    groups = spec.groups(arms.arm, arms.plant_modules, arms.layout)
    batch = (len(arms.seeds),)
    possible = Possible(arms.parameters, arms.disturbances, arms.seeds, batch, groups)
    if isinstance(spec.timestep, str):
        return float(np.min(possible.longest_steps(spec.integrator)))
    try:
        possible.check(spec.integrator, spec.timestep)
    except StepError as error:
        episode = arms.episodes[error.arm or 0]
        raise OctarmError(f"episode {episode}: {error.sentence}") from None
    return np.inf

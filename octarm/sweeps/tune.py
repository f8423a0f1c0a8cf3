"""Finding gains: the same search, with the same budget, for every controller.

Differential evolution searches the `Space` of a controller's gains for the least cost by
`octarm.sweeps.tune_cost`. A whole generation is one batch of arms, each candidate in every
scenario. It has random numbers of its own, and begins from nothing but the population and its
costs: a search that goes on from a file ends with the same bits.

What learns or integrates may do well for a while and drift away later. So the best of the last
generation, and the hand-set gains, are tried for longer and under other noise; the best there wins.
These last trials, and all costs in the result, are MuJoCo's, whatever engine the search has.
"""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from octarm.errors import OctarmError
from octarm.files import write_text
from octarm.formats import Model, read_json, to_json
from octarm.interfaces import Controller, Knob, Tunable
from octarm.roll_off import fields_of
from octarm.runs import versions as origin
from octarm.simulation.engines import MUJOCO
from octarm.sweeps.scenarios import Examination
from octarm.sweeps.tune_cost import FORMULA, Budget, Rig, costs
from octarm.sweeps.workers import WorkerProcesses

_PACKAGES = ("python", "octarm", "mujoco", "dm-control", "numpy", "scipy")
_AROUND = 0.5  # decades around the hand-set gains that the search begins in; it may leave them


class Unknown(NamedTuple):
    """One coordinate of the search.

    Attributes:
        share: 1 for the coordinates of the arm that it is for, 0 for others, shape (2N,).
    """

    name: str
    knob: Knob
    share: np.ndarray


class Space:
    """The gains of one controller, and what is searched.

    A candidate is a vector of d numbers: the logarithms, base 10, of the factors of the unknowns.
    That of the hand-set gains is zero. All gains are numbers in the scales of the nominal model.

    Attributes:
        gains: the hand-set ones, by name.
        bounds: smallest and largest entry of a candidate, shape (d, 2).
    """

    def __init__(self, controller: Tunable, modules: int) -> None:
        """The space around a controller with its hand-set gains, one at least to be tuned."""
        scales = controller.scales()
        self.gains = {name: gain / scales[name] for name, gain in gains_of(controller).items()}
        self.knobs = controller.knobs()
        slides, every = np.repeat([1.0, 0.0], modules), np.ones(2 * modules)
        self.unknowns: list[Unknown] = []
        for knob in self.knobs:
            parts = {" of slides": slides, " of bends": 1.0 - slides} if knob.apart else {"": every}
            self.unknowns += [Unknown(knob.name + part, knob, x) for part, x in parts.items()]
        if not self.unknowns:
            raise OctarmError(
                f"{type(controller).__name__} has no gain that can be tuned; give one a knob"
            )
        self.bounds = np.log10([(u.knob.low, u.knob.high) for u in self.unknowns])

    def turned(self, candidates: np.ndarray) -> dict[str, np.ndarray]:
        """The gains that are tuned: candidates, shape (n, d), to gains of shape (n, 2N)."""
        table: dict[str, np.ndarray] = {}
        for unknown, logarithms in zip(self.unknowns, candidates.T, strict=True):
            factors = 10.0 ** (unknown.share[:, None] * logarithms)
            for name in unknown.knob.gains:
                table[name] = table.get(name, self.gains[name].reshape(-1, 1)) * factors
        return {name: _rounded(columns).T for name, columns in table.items()}

    def fixed(self) -> dict[str, np.ndarray]:
        """The gains that stay as they are, each of the shape of its value in `gains`."""
        tuned = {name for unknown in self.unknowns for name in unknown.knob.gains}
        return {name: gain for name, gain in self.gains.items() if name not in tuned}

    def at_bounds(self, candidate: np.ndarray) -> list[str]:
        """The unknowns at an end of their range, within 1 %, of a candidate of shape (d,)."""
        low, high = self.bounds.T
        ends = np.minimum(candidate - low, high - candidate) < 0.01 * (high - low)
        return [u.name for u, at_end in zip(self.unknowns, ends, strict=True) if at_end]


def gains_of(controller: Controller) -> dict[str, np.ndarray]:
    """The gains of a controller that are numbers [SI], by the names under which they are given.

    Arrays have shape (), or that in which the controller holds them, mostly (2N,).
    """
    return {
        name.rstrip("_"): np.asarray(value)
        for name, value in fields_of(controller).items()
        if isinstance(value, float | np.ndarray)
    }


def _rounded(gains: np.ndarray) -> np.ndarray:
    """Numbers to four digits: more than anybody can tell apart, and good to read."""
    return np.reshape([float(f"{x:.4g}") for x in gains.ravel().tolist()], gains.shape)


class SearchState(NamedTuple):
    """The search after a generation, 0 being the initial one; the best candidate comes first.

    Attributes:
        population: candidates, shape (n, d) [1].
        costs: of each of them, shape (n,) [1].
    """

    generation: int
    population: np.ndarray
    costs: np.ndarray


class Costs(NamedTuple):
    """Costs in each scenario.

    Attributes:
        tuned: with tuned gains, shape (scenarios,) [1].
        by_hand: with hand-set ones, likewise.
    """

    tuned: np.ndarray
    by_hand: np.ndarray


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Tuned:
    """The result of a search, with the costs of its gains in three examinations.

    Attributes:
        gains: all that are numbers, by name, in the scales of the nominal model, shape () or (2N,).
        short: as in the search.
        long: in the longer examination.
        unseen: in scenarios that nothing was chosen by.
        at_bounds: the unknowns that are as small or large as they were allowed to be.
    """

    gains: Mapping[str, np.ndarray]
    short: Costs
    long: Costs
    unseen: Costs
    at_bounds: list[str]


def tune(
    factory: Callable[..., Tunable],
    budget: Budget,
    *,
    seed: int = 0,
    state: SearchState | None = None,
    keep: Callable[[SearchState], object] = lambda state: None,
    progress: Callable[[float], object] = lambda seconds: None,
    rig: Rig | None = None,
    workers: WorkerProcesses | None = None,
) -> Tuned:
    """Searches gains; the same bits for the same arguments, wherever it went on from.

    Args:
        factory: makes the controller from its nominal model and gains; hand-set ones where not
            given.
        budget: how much is tried.
        seed: of the search. The scenarios do not depend on it.
        state: where an earlier search stopped; the beginning when not given.
        keep: called with the state after every generation.
        progress: called with simulated seconds as they pass, see `tune_cost.costs`.
        rig: what they are tried on, see `tune_cost.costs`.
        workers: that try them; the result does not depend on them.

    Raises:
        OctarmError: if the controller cannot be made, or has no gain that can be tuned.
    """
    rig = rig or Rig()
    nominal = rig.arm()
    space = Space(factory(nominal, {}), nominal.modules)
    make = functools.partial(_made, factory, space.fixed())
    of_record = dataclasses.replace(rig, engine=MUJOCO)

    def tried(candidates: np.ndarray, rig: Rig, *examinations: Examination) -> list[np.ndarray]:
        return costs(examinations, make, space.turned(candidates), progress, rig, workers)

    def cost(candidates: np.ndarray) -> np.ndarray:
        return budget.short.mean(*tried(candidates, rig, budget.short))

    if state is None:
        population = initial_population(space.bounds, budget.population, _random(seed, 0))
        state = SearchState(0, population, cost(population))
        keep(state)
    else:
        size = (budget.population, len(space.bounds))
        if state.population.shape != size or state.costs.shape != size[:1] or state.generation < 0:
            raise OctarmError(
                f"the search to go on with has candidates of shape {state.population.shape}; they "
                f"must be {size}, each with its cost, after at least 0 generations"
            )
        progress((state.generation + 1) * budget.population * budget.short.seconds)
    while state.generation < budget.generations - 1:
        state = next_generation(cost, space.bounds, state, _random(seed, state.generation + 1))
        keep(state)
    best = state.population[np.argsort(state.costs, kind="stable")[: budget.finalists]]
    finalists = np.concatenate([best, np.zeros_like(best[:1])])
    (long,) = tried(finalists, of_record, budget.long)
    winner = int(np.argmin(budget.long.mean(long)))
    both = finalists[[winner, -1]]
    short, unseen = (Costs(*x) for x in tried(both, of_record, budget.short, budget.unseen))
    turned = {name: rows[winner] for name, rows in space.turned(finalists).items()}
    return Tuned(
        gains={name: turned.get(name, gain) for name, gain in space.gains.items()},
        short=short,
        long=Costs(long[winner], long[-1]),
        unseen=unseen,
        at_bounds=space.at_bounds(finalists[winner]),
    )


def _made(
    factory: Callable[..., Tunable],
    fixed: Mapping[str, np.ndarray],
    nominal: Any,
    numbers: Mapping[str, np.ndarray],
) -> Controller:
    """The controller with gains that are numbers in the scales of its nominal model."""
    scales = factory(nominal, {}).scales()
    return factory(nominal, {n: x * scales[n] for n, x in {**fixed, **numbers}.items()})


def initial_population(bounds: np.ndarray, size: int, random: np.random.Generator) -> np.ndarray:
    """The hand-set gains, and a Latin hypercube around them, from a third to three times them.

    For bounds of shape (d, 2) and a size n these are candidates of shape (n, d).
    """
    spread = qmc.LatinHypercube(len(bounds), rng=random).random(size - 1)
    low, high = np.clip(bounds, -_AROUND, _AROUND).T
    return np.concatenate([np.zeros((1, len(bounds))), low + spread * (high - low)])


def next_generation(
    cost: Callable[[np.ndarray], np.ndarray],
    bounds: np.ndarray,
    state: SearchState,
    random: np.random.Generator,
) -> SearchState:
    """One step of differential evolution, with the settings that scipy comes with.

    The cost takes candidates of shape (n, d) to (n,); the bounds have shape (d, 2).
    """
    known = [state.costs]  # scipy asks for the costs of the population first

    def evaluate(columns: np.ndarray) -> np.ndarray:
        return known.pop() if known else cost(columns.T)

    result = differential_evolution(
        evaluate, bounds, maxiter=1, tol=0.0, polish=False, updating="deferred", vectorized=True,
        rng=random, init=state.population,  # pyright: ignore[reportArgumentType]
    )  # fmt: skip
    return SearchState(state.generation + 1, result.population, result.population_energies)


def _random(seed: int, generation: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(generation,)))


class _StateContent(Model):
    settings: dict[str, Any]
    generation: int
    population: list[list[float]]
    costs: list[float]


class StateFile:
    """The state of a search on disk, and the settings that it belongs to."""

    def __init__(self, path: Path, settings: Mapping[str, Any]) -> None:
        """A file, and all that the search depends on, ready for JSON."""
        self.path = path
        self._settings = json.loads(json.dumps(settings))

    def write(self, state: SearchState) -> None:
        """Replaces the file, whole or not at all."""
        write_text(self.path, to_json({"settings": self._settings, **state._asdict()}))

    def read(self) -> SearchState:
        """The state; raises OctarmError if there is none, or it belongs to another search."""
        if not self.path.exists():
            raise OctarmError(f"there is nothing to resume: {self.path} does not exist")
        content = read_json(self.path).read(_StateContent)
        for key in self._settings:
            if content.settings.get(key) != self._settings[key]:
                other = f"{self.path} belongs to a search with another {key}"
                raise OctarmError(f"{other}; go on with that one, or delete the file")
        try:
            population, costs = np.array(content.population), np.array(content.costs)
        except ValueError:
            raise OctarmError(f"{self.path} has candidates of different lengths") from None
        return SearchState(content.generation, population, costs)


def settings(controller: str, space: Space, budget: Budget, seed: int, rig: Rig) -> dict[str, Any]:
    """All that a search depends on, ready for JSON."""
    return {
        "controller": controller,
        "seed": seed,
        **rig.settings(),
        "budget": dataclasses.asdict(budget),
        "gains": {name: gain.tolist() for name, gain in space.gains.items()},
        "range": [knob._asdict() for knob in space.knobs],
        "objective": FORMULA,
        "versions": versions(),
    }


def versions() -> dict[str, str]:
    """What the result depends on for being found again."""
    return {name: x for name, x in origin.versions().items() if name in _PACKAGES}

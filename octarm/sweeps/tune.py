"""Finding gains: the same search, with the same budget, for every controller.

Differential evolution searches the space of `octarm.sweeps.tune_space` for the least cost by
`octarm.sweeps.tune_objective`. A whole generation is one batch of arms, each candidate in every
scenario.

Every generation has random numbers of its own, and begins from nothing but the population and its
costs. These are all there is to keep: a search that goes on from a file ends with the same bits.

What learns or integrates may do well for a while and drift away later. So the best of the last
generation, and the hand-set gains, are tried for longer and under other noise; the best there wins.
"""

from __future__ import annotations

import dataclasses
import json
import math
import platform
from collections.abc import Callable, Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.optimize import differential_evolution
from scipy.stats import qmc

from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.errors import OctarmError
from octarm.files import write_text
from octarm.interfaces import Controller, Tunable
from octarm.sweeps.tune_objective import FORMULA, LONG, SHORT, Trial, costs
from octarm.sweeps.tune_space import Space

_PACKAGES = ("octarm", "mujoco", "dm-control", "numpy", "scipy")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Effort:
    """How much is tried; the same for every controller.

    Attributes:
        population: candidates in a generation.
        generations: of the search, the initial one included.
        finalists: candidates of the last one that are tried for longer, with the hand-set gains.
        short: what the search is about.
        long: what decides between the finalists.
    """

    population: int = 24
    generations: int
    finalists: int = 7
    short: Trial = SHORT
    long: Trial = LONG

    @classmethod
    def within(cls, budget: float) -> Effort:
        """As many generations as fit into a budget for the search, in simulated seconds [s].

        Raises:
            ValueError: if not even one does, or the budget is not finite.
        """
        generation = cls(generations=1).search_seconds
        if not generation <= budget < math.inf:
            raise OctarmError(
                f"budget is {budget:g} s; it must be at least {generation:g} s, one generation, "
                "and finite"
            )
        return cls(generations=int(budget // generation))

    @property
    def search_seconds(self) -> float:
        """What the search simulates, all arms counted [s]."""
        return self.generations * self.population * self.short.seconds

    @property
    def seconds(self) -> float:
        """What is simulated in all, all arms counted [s]."""
        final = self.short.seconds + self.long.seconds
        return self.search_seconds + (self.finalists + 1) * final


class State(NamedTuple):
    """The search after a generation; the best candidate comes first.

    Attributes:
        generation: its number; 0 is the initial one.
        population: candidates, shape (n, d) [1].
        costs: of each of them, shape (n,) [1].
    """

    generation: int
    population: np.ndarray
    costs: np.ndarray


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Tuned:
    """What came of it.

    Attributes:
        gains: all gains of the controller that are numbers, by name, shape () or (2N,).
        short: cost in each scenario of the search, shape (scenarios,) [1].
        long: cost in each scenario of the longer trial, shape (scenarios,) [1].
        short_by_hand: likewise with the hand-set gains.
        long_by_hand: likewise.
        at_bounds: the unknowns that are as small or large as they were allowed to be.
    """

    gains: Mapping[str, np.ndarray]
    short: np.ndarray
    long: np.ndarray
    short_by_hand: np.ndarray
    long_by_hand: np.ndarray
    at_bounds: list[str]


def tune(
    factory: Callable[[ArmParameters, Mapping[str, npt.ArrayLike]], Tunable],
    effort: Effort,
    *,
    seed: int = 0,
    state: State | None = None,
    keep: Callable[[State], object] = lambda state: None,
    progress: Callable[[float], object] = lambda seconds: None,
) -> Tuned:
    """Searches gains; the same bits for the same arguments, wherever it went on from.

    Args:
        factory: makes the controller from gains of shape (..., 2N); those that it is not given
            are the hand-set ones.
        effort: how much is tried.
        seed: of the search. The scenarios do not depend on it.
        state: where an earlier search stopped; the beginning when not given.
        keep: called with the state after every generation.
        progress: called with simulated seconds as they pass, see `tune_objective.costs`.

    Raises:
        ValueError: if the controller cannot be made, or has no gain that can be tuned.
    """
    nominal = nominal_parameters()
    space = Space(factory(nominal, {}), nominal.modules)
    fixed = space.fixed()

    def make(nominal: ArmParameters, gains: Mapping[str, npt.ArrayLike]) -> Controller:
        return factory(nominal, fixed | dict(gains))

    def tried(trial: Trial, candidates: np.ndarray) -> np.ndarray:
        return costs(trial, make, space.turned(candidates), progress)

    def cost(candidates: np.ndarray) -> np.ndarray:
        return tried(effort.short, candidates).mean(axis=1)

    if state is None:
        population = initial_population(space.bounds, effort.population, _random(seed, 0))
        state = State(0, population, cost(population))
        keep(state)
    else:
        progress((state.generation + 1) * effort.population * effort.short.seconds)
    while state.generation < effort.generations - 1:
        state = next_generation(cost, space.bounds, state, _random(seed, state.generation + 1))
        keep(state)
    best = state.population[np.argsort(state.costs, kind="stable")[: effort.finalists]]
    finalists = np.concatenate([best, np.zeros_like(best[:1])])
    short, long = (tried(trial, finalists) for trial in (effort.short, effort.long))
    winner = int(np.argmin(long.mean(axis=1)))
    found = {name: rows[winner] for name, rows in space.turned(finalists).items()}
    return Tuned(
        gains={name: found.get(name, gain) for name, gain in space.gains.items()},
        short=short[winner],
        long=long[winner],
        short_by_hand=short[-1],
        long_by_hand=long[-1],
        at_bounds=space.at_bounds(finalists[winner]),
    )


def initial_population(bounds: np.ndarray, size: int, random: np.random.Generator) -> np.ndarray:
    """The hand-set gains, and a Latin hypercube that fills the inner half of each range.

    Args:
        bounds: shape (d, 2).
        size: number of candidates n.
        random: what it is drawn from.

    Returns:
        Candidates, shape (n, d).
    """
    spread = qmc.LatinHypercube(len(bounds), rng=random).random(size - 1)
    low, high = 0.5 * bounds.T
    return np.concatenate([np.zeros((1, len(bounds))), low + spread * (high - low)])


def next_generation(
    cost: Callable[[np.ndarray], np.ndarray],
    bounds: np.ndarray,
    state: State,
    random: np.random.Generator,
) -> State:
    """One step of differential evolution, with the settings that scipy comes with.

    Args:
        cost: of candidates, shape (n, d) to (n,).
        bounds: shape (d, 2).
        state: the generation before.
        random: for this generation alone.
    """
    known = [state.costs]  # scipy asks for the costs of the population first

    def evaluate(columns: np.ndarray) -> np.ndarray:
        return known.pop() if known else cost(columns.T)

    result = differential_evolution(
        evaluate,
        bounds,
        init=state.population,  # pyright: ignore[reportArgumentType]
        maxiter=1,
        tol=0.0,
        polish=False,
        updating="deferred",
        vectorized=True,
        rng=random,
    )
    return State(state.generation + 1, result.population, result.population_energies)


def _random(seed: int, generation: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(generation,)))


class StateFile:
    """The state of a search on disk, and the settings that it belongs to."""

    def __init__(self, path: Path, settings: Mapping[str, Any]) -> None:
        """A file, and all that the search depends on, ready for JSON."""
        self.path = path
        self._settings = json.loads(json.dumps(settings))

    def write(self, state: State) -> None:
        """Replaces the file, whole or not at all."""
        generation, population, costs = state
        content = {
            "settings": self._settings,
            "generation": generation,
            "population": population.tolist(),
            "costs": costs.tolist(),
        }
        write_text(self.path, json.dumps(content, indent=1) + "\n")

    def read(self) -> State:
        """The state.

        Raises:
            ValueError: if there is none, or it belongs to another search.
        """
        try:
            content = json.loads(self.path.read_text(encoding="utf-8"))
            settings = content["settings"]
            numbers = (np.array(content[key]) for key in ("population", "costs"))
            state = State(content["generation"], *numbers)
        except FileNotFoundError:
            raise OctarmError(f"there is nothing to resume: {self.path} does not exist") from None
        except (ValueError, KeyError, TypeError) as error:
            raise OctarmError(
                f"{self.path} is damaged ({error}); delete it and start anew"
            ) from None
        for key in self._settings:
            if settings.get(key) != self._settings[key]:
                raise OctarmError(
                    f"{self.path} belongs to a search with another {key}; go on with that one, or "
                    "delete the file"
                )
        return state


def settings(controller: str, space: Space, effort: Effort, seed: int) -> dict[str, Any]:
    """All that a search depends on, ready for JSON."""
    return {
        "controller": controller,
        "seed": seed,
        "budget": dataclasses.asdict(effort),
        "gains": {name: gain.tolist() for name, gain in space.gains.items()},
        "range": [knob._asdict() for knob in space.knobs],
        "objective": FORMULA,
        "versions": versions(),
    }


def versions() -> dict[str, str]:
    """What the result depends on for being found again."""
    return {"python": platform.python_version(), **{name: version(name) for name in _PACKAGES}}

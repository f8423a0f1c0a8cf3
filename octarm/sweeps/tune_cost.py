"""What tuning minimises: the same number for every controller, fixed before anything was tuned.

    J = weighted mean over scenarios of (e + w c),                              w = 0.1
    e = sqrt(mean_j (rms_j / A_j)^2)        rms_j of q_j - q_d,j;  A = 0.0175 m, 0.3 rad
    c = sqrt(mean_i chattering_i^2) / (g sum_k m_k)                  of the input forces tau_i

Why it is what it is:

- e counts all coordinates, those that shall rest too. A is the mean amplitude of the references
  `sine-slides` and `sine`: a percent of a slide's motion is worth a percent of a bend's.
- c keeps a controller from buying accuracy with chattering that no actuator would bear. It is what
  `octarm.metrics.forces` measures above 50 Hz, twice the arm's highest mode, of the forces of
  the columns, which all have one unit, in shares of the arm's weight. With w = 0.1 a rattle of a
  tenth of the weight on every column costs as much as an error of one percent of the motion.
- An arm that leaves its limits costs 10 to 20, the more the earlier, and no other one more than 10.
  So gains that lose an arm are worse than any that do not, and a search can still tell which of
  them are the least bad.
- The scenarios are those of `octarm.sweeps.scenarios`, each with its weight.
- The measurement begins after 1 s, when the start from rest is over, and lasts one period of the
  sine. What drifts slowly does not show in that time: see `LONG`.
- No controller gets more force than the arm's input range has: what it asks for beyond is cut off.

The noise comes from seeds of its own, which no run and no sweep has, and every candidate meets the
same noise.
"""

from __future__ import annotations

import dataclasses
import heapq
import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from octarm.arm.groups import PAPER, SUMS, groups_of
from octarm.arm.lagrange import equilibrium
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.arrays import plain, split
from octarm.disturbances.episode import Disturbance
from octarm.disturbances.spelling import to_dict
from octarm.errors import OctarmError
from octarm.interfaces import ControllerFactory, Instant, Motion, Reference
from octarm.metrics.forces import Chattering
from octarm.metrics.metric import Settings
from octarm.metrics.tracking import TrackingError
from octarm.references import named_reference
from octarm.simulation.engines import LAGRANGE, MUJOCO, check_engine, usual_engine
from octarm.simulation.environment import load
from octarm.simulation.rollout import simulate
from octarm.simulation.stepping import AnyPhysics
from octarm.simulation.steps import AUTO
from octarm.sweeps.progress import arm_seconds
from octarm.sweeps.scenarios import LONG, SHORT, UNSEEN, Examination, disturbances
from octarm.sweeps.workers import WorkerProcesses

SLIDE_SCALE = 0.0175  # A [m]
BEND_SCALE = 0.3  # A [rad]
CHATTERING_WEIGHT = 0.1  # w [1]
LARGEST = 10.0  # cost of an arm that stays within its limits; one that does not costs up to twice
_MOST_SECONDS = 1e8  # of simulated time
# Measured: what Python does in a control period of 0.5 ms takes as long as steps of so many arms,
# and a step grows with this power of the number of modules.
_ARMS_OF_A_PERIOD = {MUJOCO: 50, LAGRANGE: 250}
_POWER = 1.5

FORMULA = (
    f"J = weighted mean over scenarios of sqrt(mean_j (rms_j / A_j)^2) + {CHATTERING_WEIGHT:g} "
    "sqrt(mean_i chattering_i^2) / (g sum_k m_k), with the rms of q - q_d, "
    f"A = {SLIDE_SCALE:g} m and {BEND_SCALE:g} rad, the chattering of the inputs tau above 50 Hz, "
    "tau within the actuators' range; "
    f"{LARGEST:g} to {2.0 * LARGEST:g} for an arm that is lost"
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Budget:
    """How much is tried; the same for every controller.

    Attributes:
        generations: of the search, the initial one included.
        finalists: candidates of the last one that are tried for longer, with the hand-set gains.
        unseen: what the winner is evaluated on.
    """

    population: int = 24
    generations: int
    finalists: int = 7
    short: Examination = SHORT
    long: Examination = LONG
    unseen: Examination = UNSEEN

    @classmethod
    def within(cls, seconds: float) -> Budget:
        """As many generations as the search may simulate in so many seconds [s], at least one."""
        generation = cls(generations=1).search_seconds
        if not generation <= seconds <= _MOST_SECONDS:
            raise OctarmError(
                f"budget is {seconds:g} s; it must be at least {generation:g} s, one generation, "
                f"and finite, at most {_MOST_SECONDS:g} s"
            )
        return cls(generations=int(seconds // generation))

    @property
    def search_seconds(self) -> float:
        """What the search simulates, all arms counted [s]."""
        return self.generations * self.population * self.short.seconds

    @property
    def seconds(self) -> float:
        """What is simulated in all, all arms counted [s]."""
        trials = (self.finalists + 1) * self.long.seconds
        return self.search_seconds + trials + 2 * (self.short.seconds + self.unseen.seconds)


@dataclasses.dataclass(frozen=True)
class Rig:
    """What controllers are tried on; the nominal arm when no parameters are given.

    Attributes:
        reference: that all scenarios have; their own when None.
        disturbances: that act as well.
        mismatch: a further error of the controller's model, see `ArmParameters.mismatched` [1].
        nominal: further factors on parameters of that model, by name, each likewise [1].
    """

    engine: str = dataclasses.field(default_factory=usual_engine)
    plant_modules: int | None = None
    layout: str = PAPER
    sensing: str = SUMS
    parameters: ArmParameters | None = None
    reference: str | None = None
    disturbances: tuple[Disturbance, ...] = ()
    mismatch: float = 0.0
    nominal: Mapping[str, npt.ArrayLike] = dataclasses.field(default_factory=dict[str, float])

    def arm(self) -> ArmParameters:
        """The arm, which is the nominal one if no parameters are given."""
        return nominal_parameters() if self.parameters is None else self.parameters

    def check(self) -> None:
        """Raises OctarmError if there is no such engine or plant."""
        check_engine(self.engine)
        groups_of(self.arm(), self.plant_modules, self.layout, self.sensing)

    def settings(self) -> dict[str, Any]:
        """What the result depends on, ready for JSON and TOML."""
        numbers: dict[str, Any] = {"engine": self.engine}
        if self.plant_modules is not None:
            numbers |= {
                name: getattr(self, name) for name in ("plant_modules", "layout", "sensing")
            }
        if self.parameters is not None:
            numbers["arm"] = self.parameters.to_dict()
        more = {
            "reference": self.reference,
            "disturbances": [to_dict(each) for each in self.disturbances],
            "mismatch": self.mismatch,
            "nominal": {name: plain(factor) for name, factor in self.nominal.items()},
        }
        return numbers | {name: value for name, value in more.items() if value}

    def rest(self) -> np.ndarray:
        """Where the arm hangs, shape (2N,) [m], [rad]."""
        arm = self.arm()
        groups = groups_of(arm, self.plant_modules, self.layout)
        return equilibrium(arm) if groups is None else groups.measured(equilibrium(groups.plant))


def costs(
    examinations: Sequence[Examination],
    factory: ControllerFactory,
    candidates: Mapping[str, np.ndarray],
    progress: Callable[[float], object] = lambda seconds: None,
    rig: Rig | None = None,
    workers: WorkerProcesses | None = None,
) -> list[np.ndarray]:
    """The cost of each candidate in each scenario of each examination, shapes (n, scenarios) [1].

    J is its `Examination.mean`. A cost does not depend on the other candidates, nor on workers.
    Candidates are gains by name with a row for each, shapes (n, 1) or (n, 2N); the factory makes
    the controller of its nominal model and gains, hand-set where not given. The progress is called
    with the seconds that were simulated since the last call, all arms counted. For workers it must
    be possible to pickle the factory.
    """
    rig, n = rig or Rig(), len(next(iter(candidates.values())))
    check_engine(rig.engine)
    tables = [np.empty((n, len(examination.scenarios))) for examination in examinations]
    parts = _parts(examinations, n, rig, 1 if workers is None else workers.count)
    if workers is None:
        for number, places in parts:
            trial = examinations[number], places
            tables[number][:, places] = _costs(trial, factory, candidates, rig, progress)
        return tables
    calls = [
        workers.submit(_costs, (examinations[number], places), factory, candidates, rig)
        for number, places in parts
    ]
    for (number, places), call in zip(parts, calls, strict=True):
        tables[number][:, places] = call.result()
        progress(n * len(places) * examinations[number].duration)
    return tables


def _parts(
    examinations: Sequence[Examination], candidates: int, rig: Rig, workers: int
) -> list[tuple[int, list[int]]]:
    """What is tried together: numbers of an examination and of scenarios, the longest trial first.

    These have one control period and one plant. More parts keep all workers busy, but each costs
    the calls of all periods: there are as many as let the last worker end earliest, by an estimate.
    """
    kinds: dict[tuple[int, float, int], list[int]] = {}
    for number, examination in enumerate(examinations):
        for place, scenario in enumerate(examination.scenarios):
            kind = number, scenario.period, scenario.plant_modules
            kinds.setdefault(kind, []).append(place)
    usual = rig.arm().modules

    def time_of(part: tuple[int, list[int]]) -> float:
        """How long a trial takes, in what a second of an arm of the usual size takes."""
        number, places = part
        own = examinations[number].scenarios[places[0]].plant_modules
        modules = own or rig.plant_modules or usual
        arms = candidates * len(places) * (modules / usual) ** _POWER
        return examinations[number].duration * (_ARMS_OF_A_PERIOD[rig.engine] + arms)

    def cut(most: int) -> list[tuple[int, list[int]]]:
        """Parts of so many scenarios at most."""
        parts = [
            (number, piece.tolist())
            for (number, *_), places in kinds.items()
            for piece in np.array_split(places, math.ceil(len(places) / most))
        ]
        return sorted(parts, key=time_of, reverse=True)

    def end(parts: list[tuple[int, list[int]]]) -> float:
        busy = [0.0] * workers  # until when; the next part goes to the first that is free
        for part in parts:
            heapq.heapreplace(busy, busy[0] + time_of(part))
        return max(busy)

    longest = max(map(len, kinds.values()), default=1)
    return min(map(cut, range(longest, 0, -1)), key=end)


def _costs(
    trial: tuple[Examination, Sequence[int]],
    factory: ControllerFactory,
    candidates: Mapping[str, np.ndarray],
    rig: Rig,
    progress: Callable[[float], object] = lambda seconds: None,
) -> np.ndarray:
    """The costs in the scenarios with these numbers, of one control period and one plant."""
    examination, places = trial
    n = len(next(iter(candidates.values())))
    scenarios, seeds = [examination.scenarios[i] for i in places], examination.seeds()
    if rig.reference is not None:
        scenarios = [dataclasses.replace(each, reference=rig.reference) for each in scenarios]
    if scenarios[0].plant_modules:
        rig = dataclasses.replace(rig, plant_modules=scenarios[0].plant_modules)

    def each(values: Sequence[float]) -> np.ndarray:
        """Values of the scenarios for each arm: the scenarios of a candidate side by side."""
        return np.tile(values, n)

    true, rest = rig.arm(), rig.rest()
    names = list(dict.fromkeys(s.reference for s in scenarios))
    motions = [named_reference(name, rest, true) for name in names]
    environment = load(
        each_its_own(motions, each([names.index(s.reference) for s in scenarios])),
        disturbances=[
            *disturbances([scenario for _ in range(n) for scenario in scenarios]),
            *rig.disturbances,
        ],
        batch=n * len(scenarios),
        control_period=scenarios[0].period,
        seed=[seeds[i] for i in places] * n,
        timestep=None if rig.plant_modules in (None, true.modules) else AUTO,
        parameters=true,
        engine=rig.engine,
        plant_modules=rig.plant_modules,
        layout=rig.layout,
        sensing=rig.sensing,
    )
    damping = each([scenario.damping for scenario in scenarios])[:, None, None]
    nominal = true.mismatched(each([scenario.mismatch for scenario in scenarios]))
    nominal = nominal.scaled(damping=damping).mismatched(rig.mismatch).scaled(**rig.nominal)
    gains = {name: np.repeat(x.T, len(scenarios), axis=-1).T for name, x in candidates.items()}
    observer = _Observer(examination, environment.control_timestep(), environment.physics)
    with arm_seconds(environment, examination.duration, progress) as seconds:
        simulate(environment, factory(nominal, gains), examination.duration, observer, seconds)
    return observer.costs(true).reshape(n, len(scenarios))


def each_its_own(motions: Sequence[Motion], choice: np.ndarray) -> Motion:
    """A desired motion for each arm of a batch, out of a few of one arm each.

    Which of them each arm has is its `choice`, shape (n,).
    """

    def wanted(t: float) -> Reference:
        few = np.array([motion(t) for motion in motions]).transpose(1, 2, 0)
        return Reference(*(part.T for part in few.take(choice, -1)))

    return wanted


class _Observer:
    def __init__(self, examination: Examination, period: float, physics: AnyPhysics) -> None:
        self._examination, self._period, self._physics = examination, period, physics
        like = np.zeros_like(physics.q())
        first, settings = {"q": like, "force": like}, Settings(control_period=period)
        self._error, self._chattering = TrackingError(first, settings), Chattering(first, settings)

    def __call__(self, instant: Instant) -> None:
        steady = instant.measurement.t > self._examination.begin - 0.5 * self._period
        with np.errstate(all="ignore"):  # an arm that is lost may hold anything
            self._chattering.update({"force": instant.tau[None]}, steady)
            assert instant.within is not None  # errors count at every physics step
            error = instant.within.q - instant.within.q_d
            self._error.update({"error": error, "squared_error": error * error}, steady)

    def costs(self, true: ArmParameters) -> np.ndarray:
        with np.errstate(all="ignore"):
            rms, rattle = self._error.result()["rms_error"], self._chattering.result()["chattering"]
            e = root_mean_square(rms / np.repeat([SLIDE_SCALE, BEND_SCALE], true.modules))
            c = root_mean_square(rattle) / weight(true)
            kept = np.minimum(e + CHATTERING_WEIGHT * c, LARGEST)
        lost_at = self._physics.diverged_at() / self._examination.duration
        return np.where(self._physics.intact(), kept, LARGEST * (2.0 - lost_at))


def root_mean_square(x: np.ndarray) -> np.ndarray:
    """The root mean square over the last axis, shape (..., 2N) to (...)."""
    squares = (part * part for part in split(x))
    return np.sqrt(sum(squares) / x.shape[-1])


def weight(p: ArmParameters) -> float:
    """The weight of the whole arm [N]."""
    *_, total = itertools.accumulate(p.mass.tolist())
    return total * float(p.gravity)

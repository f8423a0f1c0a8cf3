"""Both engines in closed loop: the same laws under the same disturbances, instant by instant.

All arms of a law are in one batch: one arm without disturbance, and one for each disturbance, of
which the others have the neutral value. What is compared are the true coordinates, angles at the
lever l/2; of a plant of more modules, those of all its modules.

Where a law switches on sgn(s), rounding decides once s is so close to zero that the engines find
another sign, or another size by a percent, and they part: such an arm is compared up to that
instant. So is an arm whose readings are rounded, up to the first reading that comes out otherwise.
Other loops may magnify rounding, too, where a law bears what acts only just: an arm is compared up
to where it parts from itself, on one engine, when the law's forces are changed in the 14th digit.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any

import mujoco
import numpy as np

from octarm.arm.groups import PAPER, groups_of
from octarm.arm.parameters import ArmParameters
from octarm.checks.mechanics import levers
from octarm.disturbances.episode import Disturbance
from octarm.disturbances.spelling import DISTURBANCES, first_field
from octarm.interfaces import Command, Controller, Instant, Measurement, Reference
from octarm.simulation.engines import LAGRANGE, MUJOCO, check_engine
from octarm.simulation.environment import load
from octarm.simulation.rollout import simulate
from octarm.simulation.steps import AUTO
from octarm.tolerances import Check, CheckTable, run_checks

ALLOWED = 1e-9  # distance [m]
_SHARE = 0.05  # of the usual range of a disturbance
_WITHOUT_RANGE = {"saturation": 5.0, "slew": 1e4}  # [N], [N/s]; infinity is neutral
_PERCENT = 0.01
_NUDGE, _PARTED = 1e-14, 1e-10  # of a force [1], and what it may do to an arm [m]
_ROUNDED, _STEP = "quantisation", 1e-10  # [m], [rad]; far below a step of the readings


# A run of n arms at T control instants: time t, shape (T,) [s]; the true coordinates q of all
# modules, (T, n, 2N) [m], [rad]; what was read of the model's modules, (T, n, 2M); the sliding
# variable s, (T, n, 2M) [m/s], [rad/s], ones for a law without one.
_Motion = tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]


def compare_engines(
    parameters: ArmParameters,
    make: Callable[[str, ArmParameters], Controller],
    laws: Sequence[str],
    switching: Sequence[str],
    *,
    duration: float = 10.0,
    seed: int = 0,
    plant_modules: int | None = None,
    layout: str = PAPER,
    progress: Callable[[str], None] | None = None,
) -> CheckTable:
    """A check for each law: how far the engines are apart under any of the disturbances.

    `make` gives a law by its name and the nominal model; `switching` are those that switch on
    sgn(s). Runs have a duration [s]. The plant has as many modules as said in that layout, or is
    the arm itself. The progress is called with the name of each part before it starts. Raises
    OctarmError if an engine is not installed, or there is no such plant.
    """
    check_engine(LAGRANGE)
    groups = groups_of(parameters, plant_modules, layout)
    lever = levers(parameters if groups is None else groups.plant)

    def checks(law: str) -> Iterator[Check]:
        controller = make(law, parameters.mismatched(-0.1))

        def motion(law: Controller, engine: str) -> _Motion:
            return _motion(law, duration, parameters=parameters, engine=engine, seed=seed, **plant)

        one, two = motion(controller, MUJOCO), motion(controller, LAGRANGE)
        nudged = motion(_Nudged(controller), LAGRANGE)
        yield _check(law, one, two, nudged, lever, law in switching)

    plant: dict[str, Any] = {}
    on = ""
    if groups is not None:
        plant = {"plant_modules": plant_modules, "layout": layout, "timestep": AUTO}
        on = f"on a plant of {plant_modules} modules ({layout}), "
    title = (
        f"MuJoCo {mujoco.__version__} against the engine lagrange, in closed loop {on}under "
        f"{len(DISTURBANCES)} disturbances, {duration:g} s, seed {seed}"
    )
    rows = run_checks({law: checks(law) for law in laws}, progress)
    return CheckTable(title, parameters.to_dict(), len(DISTURBANCES) + 1, seed, rows)


def one_each() -> list[Disturbance]:
    """All disturbances for a batch: arm i + 1 has the i-th alone, arm 0 none."""
    listed: list[Disturbance] = []
    for i, (name, cls) in enumerate(DISTURBANCES.items()):
        field, kind = first_field(cls)
        low, high = kind.usual or (np.inf, np.inf)
        values = np.full(len(DISTURBANCES) + 1, low)
        values[i + 1] = _WITHOUT_RANGE.get(name, low + _SHARE * (high - low))
        given: dict[str, Any] = {field: values[:, None] if kind.each else values}
        listed.append(cls(**given))
    return listed


def _motion(controller: Controller, duration: float, **loaded: Any) -> _Motion:
    """A run in an environment that is loaded with all disturbances, and with what is given."""
    environment = load("sine", disturbances=one_each(), batch=len(DISTURBANCES) + 1, **loaded)
    rows: list[tuple[float, np.ndarray, np.ndarray, np.ndarray]] = []

    def observe(instant: Instant) -> None:
        s = instant.command.signals.get("s", np.ones_like(instant.q))
        q = instant.q if instant.plant_q is None else instant.plant_q
        rows.append((instant.measurement.t, q, instant.measurement.q, s))

    simulate(environment, controller, duration, observe)
    t, q, read, s = map(np.array, zip(*rows, strict=True))
    return t, q, read, s


class _Nudged:
    """A law whose forces differ in the 14th digit, as if they were rounded once more."""

    def __init__(self, law: Controller) -> None:
        self._law = law

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> Any:
        return self._law.initial_state(batch_shape)

    def __call__(
        self, state: Any, measurement: Measurement, reference: Reference
    ) -> tuple[Command, Any]:
        command, state = self._law(state, measurement, reference)
        return command._replace(force=command.force * (1.0 + _NUDGE)), state


def _check(
    law: str, one: _Motion, two: _Motion, nudged: _Motion, lever: np.ndarray, switches: bool
) -> Check:
    """One row: the largest distance of all arms, each up to where rounding decides."""
    rows = min(len(x[0]) for x in (one, two, nudged))  # fewer when all arms are lost
    (t, q, read, s), (_, q_2, read_2, s_2) = ([x[:rows] for x in motion] for motion in (one, two))
    decided = np.max(np.abs(q_2 - nudged[1][:rows]) * lever, axis=-1) > _PARTED
    if switches:
        size = np.maximum(np.abs(s), np.abs(s_2))
        decided = np.any(np.abs(s - s_2) > _PERCENT * size, axis=-1)
    rounded = 1 + list(DISTURBANCES).index(_ROUNDED)
    decided[:, rounded] |= np.any(np.abs(read - read_2)[:, rounded] > _STEP, axis=-1)
    ends = np.where(decided.any(axis=0), np.argmax(decided, axis=0), rows - 1)
    distance = np.max(np.abs(q - q_2) * lever, axis=-1)
    compared = np.arange(rows)[:, None] <= ends
    largest = np.max(np.where(compared, distance, 0.0), axis=0)
    worst = ["no disturbance", *DISTURBANCES][int(np.argmax(largest))]
    text = f"{law}, largest with {worst}"
    if early := int(np.count_nonzero(decided.any(axis=0))):
        text += f"; {early} arms until rounding decides, from t = {t[ends.min()]:g} s on"
    return Check(text, float(np.max(largest)), ALLOWED, unit="m")

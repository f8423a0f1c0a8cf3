"""The tracking task on dm_control's environment loop."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from dm_control.rl import control

from octarm.arm.actuation import ACTUATIONS
from octarm.arm.groups import PAPER, SUMS, groups_of
from octarm.arm.mjcf import build_model, build_slim_model, nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.disturbances.episode import Disturbance, Episode
from octarm.disturbances.spelling import made_of
from octarm.errors import OctarmError, closest, quoted
from octarm.interfaces import Motion
from octarm.memory import check_batch, check_steps
from octarm.references import named_reference, wanted
from octarm.simulation.arguments import check_load, whole_number
from octarm.simulation.engines import LAGRANGE, MUJOCO, check_engine
from octarm.simulation.physics import ArmPhysics, BatchPhysics
from octarm.simulation.start import REST, SHARE, Start
from octarm.simulation.stepping import AnyPhysics
from octarm.simulation.steps import (
    AUTO,
    Possible,
    check_integrator,
    check_period,
    fitting_step,
    integrator_of,
    step_check,
)
from octarm.simulation.task import TrackingTask

_MOST_THREADS = 1024

# A tracking error of this size, by its unit, earns a tenth of the reward.
_MARGINS = {"m": 0.01, "rad": 0.1}

_DURATION = 10.0  # of an episode for which nothing else is asked [s]


def load(
    reference: str | Motion = "sine",
    *,
    disturbances: Sequence[str | Disturbance] = (),
    parameters: ArmParameters | None = None,
    batch: int | None = None,
    timestep: float | str | None = None,
    control_period: float | None = None,
    duration: float | None = None,
    actuation: str = "f-coeff",
    seed: int | np.random.SeedSequence | Sequence[np.random.SeedSequence] = 0,
    threads: int = 1,
    integrator: str = "rk4",
    engine: str = MUJOCO,
    plant_modules: int | None = None,
    layout: str = PAPER,
    sensing: str = SUMS,
    groups: int | None = None,
    start: str = REST,
    start_share: float = SHARE,
    flat_observation: bool = False,
) -> control.Environment:
    """The arm, and a motion it shall follow; or a batch of n such arms.

    The action is tau, the input forces of eq (1), shape (2N,) [N]. What is within the arm's input
    range acts as the generalised force F_coeff(q) tau and is held for one control period. For a
    batch, the action and all observations have a first axis of n, and so does the reward.

    Every reset starts the next episode, with a new realisation of all that is random: episode 0 at
    the first reset, then 1 and so on. The same seed gives the same episodes. To have an episode
    once more, write its number to `environment.task.next_episode` before the reset.

    Args:
        reference: a name of `octarm.references.REFERENCES`, which may have parameters behind it,
            `sine:amplitude=0.2,frequency=1`, or a function of time that gives the desired
            coordinates, velocities and accelerations.
        disturbances: what acts on the arm that the controller does not know, made or spelt as on
            the command line, `noise:40%`.
        parameters: the true arm; the nominal one when not given. The arms of a batch may have
            their own, with batch axis (n,).
        batch: number of arms n; one arm without the batch axis when not given.
        timestep: physics step [s]; 0.5 ms when not given. `auto` is the largest part of the control
            period, 1/2, 1/5, 1/10 and so on of it, that is at most 0.5 ms and stable for the
            fastest mode of every arm that the disturbances may make.
        control_period: time between two actions [s], at most 10 s; when not given, one physics
            step, or 0.5 ms with the timestep `auto`.
        duration: when an episode ends [s], rounded up to whole control periods. When not given, it
            ends after 10 s, but `octarm.rollout` and all other loops go on for as long as they are
            asked to.
        actuation: `f-coeff`, or `internal` for forces between neighbouring modules.
        seed: of all that is random. Arm i of a batch has the seed
            `SeedSequence(seed, spawn_key=(i,))`, unless one is given for each arm. The seeds of
            its episodes are derived from it, see `octarm.disturbances.streams.episode_seed`.
        threads: that step a batch, at most 1024; results do not depend on it.
        integrator: `rk4`, or `implicitfast`, which is of first order, for arms with much damping.
        engine: `mujoco`, or `lagrange`, the analytic arm, which is some fifty times as fast and
            needs the extra `fast`; it steps by RK4 alone.
        plant_modules: number of modules of the plant, a multiple of N that is at most 100: a chain
            that stands for the same rod, of which the sums over N groups are measured and moved;
            see `octarm.arm.groups`. The arm itself when not given.
        layout: of that plant, `paper` or `centred`.
        sensing: what is read of it: `groups`, the sums, or `plates`, arcs between sensors, see
            `octarm.arm.plates`. True coordinates, errors and forces are those of the sums.
        groups: of modules, in which the arm itself, if it has more of them, is measured and moved,
            so that controllers take it for one of so many modules; all modules when not given.
        start: of an episode: `rest`, the arm hangs still; `random`, at a place that is drawn for
            each episode and arm, and still; `moving`, with a drawn velocity, too.
        start_share: share of what the inputs reach within which it is drawn, above 0 and at most 1;
            see `octarm.simulation.start`.
        flat_observation: whether all observations are one array, `observations`, of shape
            (10N + 2,), in the order below; the loops of octarm need them one by one.

    Returns:
        An environment with the observations q, v, q_d, v_d, a_d, each of shape (2N,), and
        tip_position, shape (2,), where the arm seems to have it: the world's x and z, in the plane
        of the arm.

    Raises:
        OctarmError: for an unknown name, an engine that is not installed, a period that is not a
            whole multiple of the step, an arm that does not hang within its limits, a step that is
            too long for its fastest mode, or more arms than memory holds.
    """
    times = {"control_period": control_period, "duration": duration, "start_share": start_share}
    if not isinstance(timestep, str):
        times["timestep"] = timestep
    check_load(reference, disturbances, parameters, seed, **times)
    made = made_of(disturbances)
    batch = None if batch is None else whole_number("batch", batch, 1)
    threads = whole_number("threads", threads, 1, _MOST_THREADS)
    check_engine(engine)
    if actuation not in [*ACTUATIONS]:
        raise OctarmError(f"unknown actuation {quoted(actuation)}{closest(actuation, ACTUATIONS)}")
    check_integrator(integrator)
    if engine == LAGRANGE and integrator != "rk4":
        raise OctarmError(f"engine {engine!r} steps by rk4 alone; integrator is {integrator!r}")
    true = nominal_parameters() if parameters is None else parameters
    if true.batch_shape not in ((), () if batch is None else (batch,)):
        raise OctarmError(
            f"parameters have batch axes {true.batch_shape}; the environment has "
            f"{'one arm' if batch is None else f'{batch} arms'}"
        )
    if plant_modules is not None:
        plant_modules = whole_number("plant_modules", plant_modules, 1)
    if groups is not None:
        groups = whole_number("groups", groups, 1)
    seen = groups_of(true, plant_modules, layout, sensing, groups)
    true, plant = (true, true) if seen is None else (seen.arm, seen.plant)
    if batch is not None:
        check_batch(batch, plant.modules)
    seeds = _seeds(seed, batch)
    if isinstance(timestep, str):
        if timestep != AUTO:
            raise OctarmError(f"timestep is {timestep!r}; it must be a number [s], or {AUTO!r}")
        axes = () if batch is None else (batch,)
        steps = Possible(true, made, seeds, axes, seen).longest_steps(integrator)
        timestep, control_period = fitting_step(float(np.min(steps)), control_period)
    forces = ACTUATIONS[actuation](true.widths)
    if engine == LAGRANGE:
        from octarm.simulation.analytic import LagrangePhysics  # only where numba is installed

        physics = LagrangePhysics(plant, batch, forces, timestep=timestep, threads=threads)
    elif batch is None:
        model = build_model(plant, timestep)
        model.opt.integrator = integrator_of(integrator)
        physics = ArmPhysics.from_arm_model(model, forces)
    else:
        model = build_slim_model(plant.arm(0) if plant.batch_shape else plant, timestep)
        model.opt.integrator = integrator_of(integrator)
        physics = BatchPhysics(model, batch, forces, parameters=plant, threads=threads)
    if seen is not None:
        physics.see_through(seen)
    _check_rest(physics)
    step = physics.timestep()
    steps_a_period = 1 if control_period is None else _whole_steps(control_period, step)
    check_steps(steps_a_period, batch or 1, true.modules)
    rest, plant_rest = physics.hanging(), physics.plant_rest()
    if not true.batch_shape:  # one for all arms that hang alike
        rest, plant_rest = (x[*[0] * (x.ndim - 1)] for x in (rest, plant_rest))
    motion = named_reference(reference, rest, true) if isinstance(reference, str) else reference
    wanted(motion, 0.0, physics.q().shape)  # before it is used
    period = steps_a_period * step
    episode = Episode(
        parameters=true,
        timestep=step,
        reference=motion,
        seeds=seeds,
        batch_shape=physics.batch_shape,
        check_arm=step_check(plant_rest, step, integrator),
        groups=seen,
    )
    task = TrackingTask(
        episode,
        made,
        margin=[_MARGINS[unit] for unit in physics.coordinates.units],
        period=period,
        periods=whole_periods(_DURATION if duration is None else duration, period),
        lasting=duration is None,
        start=Start.of(true, start, start_share),
        flat=flat_observation,
    )
    return control.Environment(physics, task, n_sub_steps=steps_a_period)


def _seeds(
    seed: int | np.random.SeedSequence | Sequence[np.random.SeedSequence], arms: int | None
) -> list[np.random.SeedSequence]:
    """One seed sequence an arm."""
    if isinstance(seed, int) and seed < 0:
        raise OctarmError(f"seed is {seed}; it must be at least 0")
    if isinstance(seed, Sequence):
        if len(seed) != (1 if arms is None else arms):
            raise OctarmError(f"there are {len(seed)} seeds; each of {arms or 1} arms needs one")
        return list(seed)
    root = seed if isinstance(seed, np.random.SeedSequence) else np.random.SeedSequence(seed)
    if arms is None:
        return [root]
    return [
        np.random.SeedSequence(root.entropy, spawn_key=(*root.spawn_key, i)) for i in range(arms)
    ]


def _check_rest(physics: AnyPhysics) -> None:
    """Raises OctarmError for an arm that does not hang within its limits."""
    rows = np.atleast_2d(physics.hanging())
    for i in np.flatnonzero(~physics.limits.holding(rows, np.zeros_like(rows))):
        broken = physics.limits.violation(rows[i], np.zeros_like(rows[i]))
        raise OctarmError(f"this arm cannot hang in one piece: at rest {broken}")


def whole_periods(duration: float, period: float) -> int:
    """Number of control periods [1] that cover a duration [s]; at least one.

    Raises OctarmError unless the duration is positive and at most 1e9 periods.
    """
    if not duration > 0.0:
        raise OctarmError(f"duration is {duration:g} s; it must be positive")
    if not duration / period <= 1e9:
        raise OctarmError(
            f"duration is {duration:g} s; it must be at most {1e9 * period:g} s, "
            f"1e9 control periods of {period:g} s"
        )
    return max(1, math.ceil(duration / period - 1e-6))


def _whole_steps(period: float, step: float) -> int:
    check_period(period, step)
    ratio = period / step
    if not (math.isfinite(ratio) and round(ratio) >= 1 and abs(ratio - round(ratio)) < 1e-6):
        raise OctarmError(
            f"control period is {period:g} s; it must be a whole multiple of the physics step, "
            f"{step:g} s"
        )
    return round(ratio)

"""MuJoCo against Lagrange, as a report."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator

import mujoco
import numpy as np

from octarm.arm import lagrange
from octarm.arm.mjcf import build_model, nominal_parameters, paper_order
from octarm.arm.modes import longest_step
from octarm.arm.parameters import MOST_MODULES, ArmParameters
from octarm.checks import forced_motion, free_motion, mechanics
from octarm.errors import OctarmError
from octarm.memory import check_memory
from octarm.simulation.steps import fitting_step
from octarm.tolerances import Check, CheckTable, run_checks

_BYTES = 400.0  # [byte] that a state takes for each pair of modules, measured
_RK4 = mujoco.mjtIntegrator.mjINT_RK4


def arm_with(modules: int) -> ArmParameters:
    """The nominal arm with N modules, 1 to 100, else it raises OctarmError.

    Fewer modules than nominal: the arm cut off after module N. More: a longer arm with the same
    base and tip, mass, inertia, stiffness and damping tapering in between as they do in the nominal
    one.
    """
    if not 1 <= modules <= MOST_MODULES:
        raise OctarmError(
            f"the number of modules is {modules}; it must be at least 1 and at most {MOST_MODULES}"
        )
    p = nominal_parameters()
    last = p.modules - 1
    place = np.linspace(0, last, modules) if modules > p.modules else np.arange(modules)

    def tapered(values: np.ndarray) -> np.ndarray:
        return np.interp(place, np.arange(p.modules), values)

    return dataclasses.replace(
        p,
        mass=tapered(p.mass),
        inertia=tapered(p.inertia),
        width=p.width if p.width.size == 1 else tapered(p.width),
        stiffness=[tapered(column) for column in p.stiffness],
        damping=[tapered(column) for column in p.damping],
        rest_length=tapered(p.rest_length),
    )


def random_arm(rng: np.random.Generator, modules: int) -> ArmParameters:
    """An arm of N modules that differ from `arm_with(N)`, and whose two columns differ as well.

    Factors are log-uniform: 0.6 to 1.6 on mass, inertia and stiffness, 0.5 to 1.6 on damping, 0.75
    to 1.35 on lengths and 0.3 to 1.2 on gravity. Such arms hang stably, and RK4 is stable at 1 ms.
    """

    def factor(low: float, high: float, *shape: int) -> np.ndarray:
        return np.exp(rng.uniform(np.log(low), np.log(high), shape))

    return arm_with(modules).scaled(
        mass=factor(0.6, 1.6, modules),
        inertia=factor(0.6, 1.6, modules),
        width=factor(0.75, 1.35, modules),
        stiffness=factor(0.6, 1.6, 2, modules),
        damping=factor(0.5, 1.6, 2, modules),
        rest_length=factor(0.75, 1.35, modules),
        gravity=factor(0.3, 1.2),
    )


def validate(
    parameters: ArmParameters,
    states: int = 10_000,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> CheckTable:
    """Compares MuJoCo's arm with the analytic one, point by point and in motion.

    MuJoCo takes its usual timestep, or a shorter one where the arm's fastest mode needs it. The
    timesteps at which orders of convergence are taken suit arms with some damping; on an arm with
    none at all, the dissipative DISCRETE does not get near its order.

    So many random states are compared point by point. The progress is called with the name of each
    part. Raises OctarmError if `states` is below 1, or the parameters do not describe one arm that
    hangs.
    """
    if states < 1:
        raise OctarmError(f"the number of states is {states}; it must be at least 1")
    needed = _BYTES * states * parameters.modules**2
    check_memory(needed, f"{states} states of an arm of {parameters.modules} modules")
    model = build_model(parameters)
    longest = longest_step(parameters, lagrange.equilibrium(parameters))
    model.opt.timestep, _ = fitting_step(float(longest), None)
    at_states, in_motion = map(np.random.default_rng, np.random.SeedSequence(seed).spawn(2))
    parts = {
        f"{states} random states": _compare_states(model, parameters, states, at_states),
        "static equilibrium": _compare_equilibrium(model, parameters),
        "small motions": _compare_small_motions(model, parameters),
        "free motion": _compare_free_motion(model, parameters, in_motion),
        "forced motion": _compare_forced_motion(model, parameters),
        "energy": _compare_energy(model, parameters, in_motion),
    }
    checks = run_checks(parts, progress)
    n = parameters.modules
    title = (
        f"MuJoCo {mujoco.__version__} against Lagrange: {n} module{'s' if n > 1 else ''}, "
        f"{np.sum(parameters.mass):.3g} kg, {states} states, seed {seed}"
    )
    return CheckTable(title, parameters.to_dict(), states, seed, checks)


def _compare_states(
    model: mujoco.MjModel, p: ArmParameters, count: int, rng: np.random.Generator
) -> Iterator[Check]:
    states = mechanics.random_states(p, count, rng)
    by_mujoco = mechanics.mujoco_mechanics(model, p, states)
    by_lagrange = mechanics.lagrange_mechanics(p, states)
    r = mechanics.levers(p)  # makes one unit of the entries of each quantity: forces and lengths
    force, column = 1.0 / r, 1.0 / r[:, None]
    rows: tuple[tuple[str, str, np.ndarray | float, float], ...] = (
        ("positions of the modules", "positions", 1.0, 1e-12),
        ("inertia matrix D", "inertia", column * force, 1e-12),
        ("tendon moments T", "tendon_moments", column, 1e-12),
        ("F_coeff, by forces and couples on the bodies", "coefficients", column, 1e-12),
        ("bias: Coriolis force and gravity", "bias", force, 1e-10),
        ("springs", "springs", force, 1e-10),
        ("dampers", "dampers", force, 1e-10),
        ("potential force G", "potential_force", force, 1e-10),
        ("actuators: F_coeff tau", "actuation", force, 1e-10),
        ("inverse dynamics", "inverse_dynamics", force, 1e-10),
        ("accelerations", "acceleration", r, 1e-10),
        ("kinetic energy", "kinetic", 1.0, 1e-12),
    )
    for what, name, weight, allowed in rows:
        error = mechanics.relative_error(weight * by_mujoco[name], weight * by_lagrange[name])
        yield Check(what, error, allowed)
    # Potential energies may differ by a constant; both models happen to put it at zero.
    difference = by_mujoco["potential"] - by_lagrange["potential"]
    offset, size = float(np.mean(difference)), np.max(np.abs(by_lagrange["potential"]))
    spread = float(np.max(np.abs(difference - offset)) / size)
    yield Check("potential energy, about its offset", spread, 1e-12)
    yield Check("potential energy, offset", offset, 1e-10, -1e-10, "J")


def _compare_equilibrium(model: mujoco.MjModel, p: ArmParameters) -> Iterator[Check]:
    q = lagrange.equilibrium(p)
    qpos, dof = paper_order(model)
    error = np.max(np.abs(model.key("hanging").qpos[qpos] - q) * mechanics.levers(p))
    yield Check("equilibrium, keyframe", float(error), 1e-10, unit="m")
    data = mujoco.MjData(model)
    data.qpos[qpos] = q
    mujoco.mj_forward(model, data)
    acceleration = np.max(np.abs(data.qacc[dof]) * mechanics.levers(p))
    yield Check("equilibrium, acceleration left", float(acceleration), 1e-9, unit="m/s^2")


def _compare_small_motions(model: mujoco.MjModel, p: ArmParameters) -> Iterator[Check]:
    measured = free_motion.measured_frequencies(model, p)
    error = np.max(np.abs(measured / free_motion.undamped_frequencies(p) - 1.0))
    yield Check("frequencies of small undamped oscillations", float(error), 1e-6)


def _compare_free_motion(
    model: mujoco.MjModel, p: ArmParameters, rng: np.random.Generator
) -> Iterator[Check]:
    q, v = free_motion.initial_motion(p, rng)
    reference = free_motion.reference_motion(p, q, v)
    motion = free_motion.FreeMotion(model, p, v, reference, free_motion.DURATION)
    error = motion.error(_RK4, round(motion.duration / model.opt.timestep))
    yield Check("free motion against DOP853, RK4", error, 1e-6, unit="m")
    yield from _compare_orders("order of convergence", motion)


def _compare_forced_motion(model: mujoco.MjModel, p: ArmParameters) -> Iterator[Check]:
    reference = forced_motion.references(p)
    motions = forced_motion.driven(model, p, reference)
    for what, motion in motions.items():
        steps = math.ceil(forced_motion.DURATION / forced_motion.SAMPLES / model.opt.timestep)
        error = motion.error(_RK4, steps * forced_motion.SAMPLES)
        yield Check(f"motion under {what} inputs against DOP853, RK4", error, 1e-6, unit="m")
    for what, motion in motions.items():
        yield from _compare_orders(f"order under {what} inputs", motion)
    # On an arm of one module, which ends on the base's axis, no force on the tip depends on q.
    held = (1.7, 2.3) if p.modules > 1 or p.tip_length > 0.0 else (3.7, 4.3)
    # With much damping the steps are long, and a fast mode adds terms of higher order.
    expected = {"payload": (3.7, 4.8), "sine on the tip": (0.8, 1.2)}
    for what, order in forced_motion.disturbed_orders(p, reference).items():
        low, high = expected.get(what, held)
        yield Check(f"order with a {what}, RK4", order, high, low)


def _compare_orders(what: str, motion: free_motion.FreeMotion) -> Iterator[Check]:
    for name, integrator in mujoco.mjtIntegrator.__members__.items():
        order = motion.observed_order(integrator)
        low, high = (3.7, 4.5) if integrator == _RK4 else (0.8, 1.2)
        yield Check(f"{what}, {name.removeprefix('mjINT_')}", order, high, low)


def _compare_energy(
    model: mujoco.MjModel, p: ArmParameters, rng: np.random.Generator
) -> Iterator[Check]:
    # A step takes the fraction z^6 / 72 off the energy of an oscillation, z = frequency * timestep.
    # Three times that of the fastest mode leaves room for frequencies 20 % above those at rest.
    h = model.opt.timestep
    z = 2.0 * np.pi * np.max(free_motion.undamped_frequencies(p)) * h
    loss = 3.0 * free_motion.DURATION / h * z**6 / 72.0
    q, v = free_motion.initial_motion(p, rng)
    drift = free_motion.energy_drift(model, p, q, v)
    yield Check("energy drift without damping", drift, loss)

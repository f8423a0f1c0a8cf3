"""The linearised arm against differences, and its longest step against MuJoCo's own divergence."""

import dataclasses

import mujoco
import numpy as np
import pytest

from octarm.arm import lagrange
from octarm.arm.kinematics import jacobian, jacobian_rate
from octarm.arm.mjcf import build_model, build_slim_model, nominal_parameters, paper_order
from octarm.arm.modes import (
    INTEGRATORS,
    longest_step,
    rate_bound,
    rates,
    state_matrix,
)
from octarm.checks.validation import arm_with, random_arm
from octarm.errors import OctarmError

NOMINAL = nominal_parameters()
ARMS = {
    "nominal": NOMINAL,
    "much damping": NOMINAL.scaled(damping=150.0),
    "some damping": NOMINAL.scaled(damping=3.0),
    "no damping": NOMINAL.scaled(damping=0.0),
    "light": NOMINAL.scaled(mass=1e-3, inertia=1e-3),
    "random, 3": random_arm(np.random.default_rng(5), 3),
    "random, 5": random_arm(np.random.default_rng(6), 5),
}


@pytest.mark.parametrize("n", [1, 3, 6])
def test_the_linearised_arm_is_the_slope_of_its_accelerations(n: int):
    rng = np.random.default_rng(n)
    p, q = random_arm(rng, n), rng.uniform(-0.5, 0.5, 2 * n)
    q[:n] += 1.0
    hold = lagrange.potential_force(p, q)  # what holds the arm at q, where it does not hang

    def slope(state: np.ndarray) -> np.ndarray:
        x, v = np.split(state, 2)
        return np.concatenate([v, lagrange.forward_dynamics(p, x, v, hold)])

    rest, h = np.concatenate([q, np.zeros(2 * n)]), 1e-6
    by_state = [slope(rest + e) - slope(rest - e) for e in h * np.eye(4 * n)]
    size = np.abs(state_matrix(p, q)).max()
    np.testing.assert_allclose(
        state_matrix(p, q), np.transpose(by_state) / (2 * h), atol=1e-6 * size
    )


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("name", ARMS)
def test_beyond_the_longest_step_mujoco_diverges_and_below_it_does_not(
    name: str, integrator: str, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its warnings to a file
    p = ARMS[name]
    longest = float(longest_step(p, lagrange.equilibrium(p), integrator))
    assert not _grows(p, integrator, 0.985 * longest)
    assert _grows(p, integrator, 1.015 * longest)


def _grows(p: lagrange.ArmParameters, integrator: str, step: float) -> bool:
    model = build_slim_model(p)
    model.opt.timestep = step
    model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{integrator.upper()}")
    data, order = mujoco.MjData(model), paper_order(model)[0]
    nudge = 1e-9 * np.random.default_rng(1).normal(size=p.coordinates)
    data.qpos[order] = lagrange.equilibrium(p) + nudge
    first = speed = 0.0
    for k in range(40):
        mujoco.mj_step(model, data, 50)
        speed = np.abs(data.qvel).max()
        first = speed if k == 3 else first
        if not speed < 1.0:
            return True
    return bool(speed > 50.0 * first)


def test_the_closed_forms_of_one_damped_spring():
    """Of a slide with mass m: the real axis of RK4 ends at 2.785, its imaginary one at sqrt(8)."""
    p = arm_with(1).scaled(inertia=1e3)  # the bend is slow
    q = lagrange.equilibrium(p)
    m, k = float(p.mass[0]), float(p.stiffness[:, 0].sum())
    swings = p.scaled(damping=0.0)
    w = np.sqrt(k / m)
    assert longest_step(swings, q) == pytest.approx(np.sqrt(8.0) / w, rel=1e-6)
    assert longest_step(swings, q, "implicitfast") == pytest.approx(2.0 / w, rel=1e-9)
    decays = p.scaled(damping=1e4)
    c = float(decays.damping[:, 0].sum())
    rate = (c + np.sqrt(c * c - 4.0 * k * m)) / (2.0 * m)
    assert longest_step(decays, q) == pytest.approx(2.785293563405282 / rate, rel=1e-6)


def test_every_arm_of_a_batch_has_what_it_has_alone():
    arms = [random_arm(np.random.default_rng(i), 3) for i in range(5)]
    fields = {n: np.stack([a.to_dict()[n] for a in arms]) for n in NOMINAL.to_dict()}
    batch = lagrange.ArmParameters(**fields)
    q = lagrange.equilibrium(batch)
    for integrator in INTEGRATORS:
        alone = [longest_step(a, q[i], integrator) for i, a in enumerate(arms)]
        np.testing.assert_allclose(longest_step(batch, q, integrator), alone, rtol=1e-9)


def test_the_bound_is_one_and_not_much_more():
    for p in ARMS.values():
        q = lagrange.equilibrium(p)
        fastest = np.abs(rates(p, q)).max()
        assert fastest <= rate_bound(p, q) * (1.0 + 1e-9) and rate_bound(p, q) < 10.0 * fastest


@pytest.mark.parametrize("scale", [1.0, 10.0, 150.0])
@pytest.mark.parametrize("n", [1, 3, 6])
def test_no_pose_is_faster_than_the_hanging_arm(n: int, scale: float):
    p, rng = arm_with(n).scaled(damping=scale), np.random.default_rng(0)
    q = np.concatenate(
        [p.rest_length * rng.uniform(0.5, 2.0, (2000, n)), rng.uniform(-3.1, 3.1, (2000, n))],
        axis=-1,
    )
    assert longest_step(p, lagrange.equilibrium(p)) < 1.002 * longest_step(p, q).min()


def test_a_mode_that_grows_is_physics():
    standing = dataclasses.replace(NOMINAL.scaled(width=0.3), gravity=-9.81)
    q = lagrange.equilibrium(standing)
    assert np.linalg.eigvalsh(lagrange.potential_hessian(standing, q)).min() < 0.0
    assert np.max(np.real(rates(standing, q))) == pytest.approx(5.075, rel=1e-3)
    assert longest_step(standing, q) == pytest.approx(longest_step(NOMINAL, q), rel=1e-3)
    assert np.max(np.real(rates(NOMINAL, lagrange.equilibrium(NOMINAL)))) < 0.0


def test_beyond_a_float_no_step_is_short_enough():
    p = NOMINAL.scaled(stiffness=1e300, damping=1e300)
    assert longest_step(p, lagrange.equilibrium(NOMINAL)) < 1e-290
    assert longest_step(NOMINAL.scaled(width=1e200), lagrange.equilibrium(NOMINAL)) == 0.0


# An arm of 100 modules


def test_the_stiffness_is_the_slope_of_the_potential_force_at_any_size():
    rng = np.random.default_rng(2)
    for n in (1, 2, 12):
        p, q, h = random_arm(rng, n), rng.normal(size=(3, 2 * n)), 1e-6
        slopes = [
            lagrange.potential_force(p, q + e) - lagrange.potential_force(p, q - e)
            for e in h * np.eye(2 * n)
        ]
        expected = np.stack(slopes, axis=-1) / (2 * h)
        size = np.abs(expected).max()
        np.testing.assert_allclose(lagrange.potential_hessian(p, q), expected, atol=1e-7 * size)


def test_jacobians_are_differences_of_positions():
    rng, h = np.random.default_rng(3), 1e-6
    for n in (1, 4):
        q, v = rng.normal(size=(2, 2, 2 * n))
        by = [lagrange.positions(q + e) - lagrange.positions(q - e) for e in h * np.eye(2 * n)]
        np.testing.assert_allclose(jacobian(q), np.stack(by, axis=-1) / (2 * h), atol=1e-8)
        rate = (jacobian(q + h * v) - jacobian(q - h * v)) / (2 * h)
        np.testing.assert_allclose(jacobian_rate(q, v), rate, atol=1e-7)


def test_an_arm_of_100_modules_takes_no_python_step_for_each_pair_of_them(monkeypatch):
    """Counted, not timed: the equilibrium takes a few force evaluations, one an iteration."""
    calls = []
    forces = lagrange.potential_force
    monkeypatch.setattr(lagrange, "potential_force", lambda *a: calls.append(1) or forces(*a))
    p = arm_with(100).scaled(stiffness=np.outer([1.02, 0.98], np.ones(100)))
    q = lagrange.equilibrium(p)
    assert len(calls) < 12
    assert np.abs(forces(p, q)).max() < 1e-9
    evaluations = []
    step = mujoco.mj_fwdPosition
    monkeypatch.setattr(mujoco, "mj_fwdPosition", lambda *a: evaluations.append(1) or step(*a))
    model = build_model(p)
    assert len(evaluations) < 12
    hanging = model.key("hanging").qpos[paper_order(model)[0]]
    np.testing.assert_allclose(hanging, q, atol=1e-10)


def test_more_than_100_modules_are_refused():
    with pytest.raises(OctarmError, match=r"101; it must be at least 1 and at most 100"):
        arm_with(101)
    long = {n: np.repeat(np.asarray(x)[..., :1], 101, -1) if np.shape(x)[-1:] == (3,) else x
            for n, x in NOMINAL.to_dict().items()}  # fmt: skip
    with pytest.raises(OctarmError, match=r"has 101 modules; it must have at most 100"):
        build_model(lagrange.ArmParameters(**long))

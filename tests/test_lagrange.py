"""The analytic model against mechanics: energies, symmetries, closed forms, and itself."""

from __future__ import annotations

import dataclasses
import inspect
import itertools
from collections.abc import Callable

import numpy as np
import pytest

from octarm import ArmParameters
from octarm.arm import lagrange

MODULES = pytest.mark.parametrize("n", [1, 2, 3, 5])
SHAPES = [((), ()), ((), (7,)), ((), (2, 3)), ((7,), (7,)), ((3,), (2, 3)), ((2, 3), (2, 3))]


def every_batch(test):
    """Runs a test for any shapes of arms and states."""

    def for_all_shapes(n):
        for arms, states in SHAPES:
            test(n, arms, states)

    return for_all_shapes


FUNCTIONS: dict[str, tuple[Callable, int]] = {  # and how many of q, v, a they take
    "mass_matrix": (lagrange.mass_matrix, 1),
    "coriolis_matrix": (lagrange.coriolis_matrix, 2),
    "potential_force": (lagrange.potential_force, 1),
    "potential_hessian": (lagrange.potential_hessian, 1),
    "force_coefficients": (lagrange.force_coefficients, 1),
    "inverse_dynamics": (lagrange.inverse_dynamics, 3),
    "forward_dynamics": (lagrange.forward_dynamics, 3),
    "energy": (lagrange.energy, 2),
    "kinetic_energy": (lagrange.kinetic_energy, 2),
}


def random_arm(rng: np.random.Generator, n: int, batch: tuple[int, ...] = ()) -> ArmParameters:
    def draw(low: float, high: float, *shape: int) -> np.ndarray:
        return rng.uniform(low, high, (*batch, *shape))

    return ArmParameters(
        mass=draw(0.1, 0.4, n),
        inertia=draw(2e-4, 9e-4, n),
        width=draw(0.05, 0.12, n),
        stiffness=draw(500, 1500, 2, n),
        damping=draw(2, 15, 2, n),
        rest_length=draw(0.08, 0.15, n),
        gravity=draw(5, 12),
    )


def random_state(
    rng: np.random.Generator, n: int, batch: tuple[int, ...] = ()
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coordinates, velocities and accelerations of a vigorous motion."""
    slide, bend = rng.uniform(0.04, 0.25, (*batch, n)), rng.uniform(-1.5, 1.5, (*batch, n))
    v = rng.uniform(-1, 1, (*batch, 2 * n)) * np.repeat([0.5, 6.0], n)
    a = rng.uniform(-1, 1, (*batch, 2 * n)) * np.repeat([5.0, 60.0], n)
    return np.concatenate([slide, bend], axis=-1), v, a


def dot(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.sum(x * y, axis=-1)


def times(matrix: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.sum(matrix * x[..., None, :], axis=-1)


def derivative(function: Callable, x: np.ndarray, direction: np.ndarray) -> np.ndarray:
    """The derivative along a direction, by a complex step: no cancellation, exact to rounding."""
    return np.imag(function(x + 1e-30j * direction)) / 1e-30


def assert_close(actual: np.ndarray, expected: np.ndarray, relative: float = 1e-12) -> None:
    """Equal up to rounding, measured by the largest entry."""
    assert actual.shape == expected.shape
    scale = np.max(np.abs(expected), initial=1e-3)
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=relative * scale)


def swap_columns(p: ArmParameters) -> ArmParameters:
    return dataclasses.replace(
        p, stiffness=p.stiffness[..., ::-1, :], damping=p.damping[..., ::-1, :]
    )


@MODULES
@every_batch
def test_recursion_equals_the_matrices(n, arms, states):
    rng = np.random.default_rng(1)
    p = random_arm(rng, n, arms)
    q, v, a = random_state(rng, n, states)
    v_r = random_state(rng, n, states)[1]
    rates = lagrange.coriolis_matrix(p, q, v) + lagrange.damping_matrix(p)
    rest = times(lagrange.mass_matrix(p, q), a) + lagrange.potential_force(p, q)
    assert_close(lagrange.inverse_dynamics(p, q, v, a), rest + times(rates, v))
    assert_close(lagrange.inverse_dynamics(p, q, v, a, v_r), rest + times(rates, v_r))


@MODULES
@every_batch
def test_forward_dynamics_inverts_inverse_dynamics(n, arms, states):
    rng = np.random.default_rng(2)
    p = random_arm(rng, n, arms)
    q, v, a = random_state(rng, n, states)
    force = lagrange.inverse_dynamics(p, q, v, a)
    assert_close(lagrange.forward_dynamics(p, q, v, force), a, 1e-9)


@MODULES
@every_batch
def test_mass_matrix_is_symmetric_positive_definite(n, arms, states):
    rng = np.random.default_rng(3)
    p = random_arm(rng, n, arms)
    q, _, _ = random_state(rng, n, states)
    d = lagrange.mass_matrix(p, q)
    assert_close(d, np.swapaxes(d, -1, -2), 1e-15)
    assert np.min(np.linalg.eigvalsh(d)) > 0.0


@MODULES
@every_batch
def test_rate_of_d_minus_twice_c_is_skew(n, arms, states):
    rng = np.random.default_rng(4)
    p = random_arm(rng, n, arms)
    q, v, _ = random_state(rng, n, states)
    d_rate = derivative(lambda x: lagrange.mass_matrix(p, x), q, v)
    skew = d_rate - 2.0 * lagrange.coriolis_matrix(p, q, v)
    assert_close(skew, -np.swapaxes(skew, -1, -2))


@MODULES
def test_velocity_force_is_bilinear_and_symmetric_in_its_two_velocities(n):
    rng = np.random.default_rng(5)
    p = random_arm(rng, n).scaled(damping=0.0)
    q, v, _ = random_state(rng, n)
    v_r, zero = random_state(rng, n)[1], np.zeros(2 * n)
    rest = lagrange.potential_force(p, q)
    mixed = lagrange.inverse_dynamics(p, q, v, zero, v_r) - rest
    assert_close(lagrange.inverse_dynamics(p, q, v_r, zero, v) - rest, mixed)
    assert_close(lagrange.inverse_dynamics(p, q, 2.0 * v, zero, 3.0 * v_r) - rest, 6.0 * mixed)


@MODULES
@every_batch
def test_kinetic_energy_is_that_of_the_mass_matrix(n, arms, states):
    rng = np.random.default_rng(6)
    p = random_arm(rng, n, arms)
    q, v, _ = random_state(rng, n, states)
    kinetic, _ = lagrange.energy(p, q, v)
    assert_close(kinetic, 0.5 * dot(v, times(lagrange.mass_matrix(p, q), v)))
    assert_close(lagrange.kinetic_energy(p, q, v), kinetic)


@MODULES
@every_batch
def test_potential_force_and_hessian_are_derivatives_of_the_energy(n, arms, states):
    rng = np.random.default_rng(7)
    p = random_arm(rng, n, arms)
    q, v, _ = random_state(rng, n, states)
    units = np.eye(2 * n)
    slopes = [derivative(lambda x: lagrange.energy(p, x, v)[1], q, e) for e in units]
    bends = [derivative(lambda x: lagrange.potential_force(p, x), q, e) for e in units]
    assert_close(lagrange.potential_force(p, q), np.stack(slopes, axis=-1))
    assert_close(lagrange.potential_hessian(p, q), np.stack(bends, axis=-1))


@MODULES
@every_batch
def test_power_in_less_dissipation_is_the_rate_of_the_energy(n, arms, states):
    rng = np.random.default_rng(8)
    p = random_arm(rng, n, arms)
    q, v, a = random_state(rng, n, states)
    force = lagrange.inverse_dynamics(p, q, v, a)

    def energy(x: np.ndarray) -> np.ndarray:
        return np.add(*lagrange.energy(p, x[..., : 2 * n], x[..., 2 * n :]))

    rate = derivative(energy, np.concatenate([q, v], -1), np.concatenate([v, a], -1))
    assert_close(rate, dot(v, force) - dot(v, times(lagrange.damping_matrix(p), v)))


def test_free_motion_loses_exactly_the_energy_that_the_dampers_take():
    rng = np.random.default_rng(9)
    p = random_arm(rng, 3)
    q, v, _ = random_state(rng, 3)
    step, damping, force = 1e-4, lagrange.damping_matrix(p), np.zeros(6)

    def slope(x: np.ndarray) -> np.ndarray:
        speed = x[6:12]
        acceleration = lagrange.forward_dynamics(p, x[:6], speed, force)
        return np.concatenate([speed, acceleration, [dot(speed, times(damping, speed))]])

    x = np.concatenate([q, v, [0.0]])  # the last entry is the energy dissipated so far
    start = sum(lagrange.energy(p, q, v))
    for _ in range(500):
        k1 = slope(x)
        k2 = slope(x + 0.5 * step * k1)
        k3 = slope(x + 0.5 * step * k2)
        x = x + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + slope(x + step * k3))
    lost = start - sum(lagrange.energy(p, x[:6], x[6:12]))
    assert lost > 0.5 * start
    assert lost == pytest.approx(x[12], rel=1e-8)


@MODULES
@pytest.mark.parametrize("arms", [(), (7,), (2, 3)])
def test_no_force_acts_at_the_equilibrium_and_it_is_stable(n, arms):
    p = random_arm(np.random.default_rng(10), n, arms)
    q = lagrange.equilibrium(p)
    assert q.shape == (*arms, 2 * n)
    assert np.max(np.abs(lagrange.potential_force(p, q))) < 1e-12
    assert np.min(np.linalg.eigvalsh(lagrange.potential_hessian(p, q))) > 0.0


@MODULES
@pytest.mark.parametrize("arms", [(), (7,)])
def test_equilibrium_of_equal_columns_has_the_closed_form(n, arms):
    p = random_arm(np.random.default_rng(11), n, arms)
    p = dataclasses.replace(p, stiffness=np.repeat(p.stiffness[..., :1, :], 2, axis=-2))
    carried = np.cumsum(p.mass[..., ::-1], axis=-1)[..., ::-1]
    slide = p.rest_length + p.gravity[..., None] * carried / np.sum(p.stiffness, axis=-2)
    assert_close(lagrange.equilibrium(p), np.concatenate([slide, 0.0 * slide], axis=-1))


@pytest.mark.parametrize("factor", [1e-12, 1e-4, 1e4])
def test_equilibrium_is_found_for_absurdly_soft_and_stiff_arms(factor: float):
    p = random_arm(np.random.default_rng(12), 3).scaled(stiffness=factor)
    force = lagrange.potential_force(p, lagrange.equilibrium(p))
    np.testing.assert_allclose(force, 0.0, atol=1e-10 * max(1.0, factor))


def test_one_module_is_a_mass_on_a_spring_and_an_independent_rotary_spring():
    rng = np.random.default_rng(13)
    p = random_arm(rng, 1)
    p = dataclasses.replace(p, stiffness=[p.stiffness[0]] * 2, damping=[p.damping[0]] * 2)
    (s, theta), (s_v, theta_v), (s_a, theta_a) = random_state(rng, 1)
    m, turn, k, c = p.mass[0], p.inertia[0], p.stiffness[0, 0], p.damping[0, 0]
    lever = 0.5 * p.width[0] ** 2
    expected = [
        m * s_a + 2.0 * c * s_v + 2.0 * k * (s - p.rest_length[0]) - m * p.gravity,
        turn * theta_a + lever * c * theta_v + lever * k * theta,
    ]
    q, v, a = np.array([s, theta]), np.array([s_v, theta_v]), np.array([s_a, theta_a])
    assert_close(lagrange.inverse_dynamics(p, q, v, a), np.array(expected))


@MODULES
@every_batch
def test_the_mirrored_arm_moves_in_mirror_image_bit_for_bit(n, arms, states):
    rng = np.random.default_rng(14)
    p = random_arm(rng, n, arms)
    mirror = np.repeat([1.0, -1.0], n)
    motion = random_state(rng, n, states)
    mirrored = lagrange.inverse_dynamics(swap_columns(p), *(mirror * x for x in motion))
    np.testing.assert_array_equal(mirrored, mirror * lagrange.inverse_dynamics(p, *motion))


@MODULES
def test_positions_of_a_straight_arm_add_up_along_its_axis(n):
    q, _, _ = random_state(np.random.default_rng(15), n, (4,))
    q[..., n:] = 0.0
    reached = lagrange.positions(q)
    assert_close(reached[..., 0], np.cumsum(q[..., :n], axis=-1))
    np.testing.assert_array_equal(reached[..., 1], 0.0)


@MODULES
def test_force_coefficients_do_the_work_of_forces_and_couples_on_the_ground(n):
    rng = np.random.default_rng(16)
    p = random_arm(rng, n)
    q, v, _ = random_state(rng, n)
    ends = derivative(lagrange.positions, q, v)
    plates = np.cumsum(q[n:])
    parents = plates - q[n:]
    push = np.cos(parents) * ends[:, 0] + np.sin(parents) * ends[:, 1]
    turn = 0.5 * p.width * np.cumsum(v[n:])
    power = np.stack([push + turn, push - turn], axis=-1).ravel()
    assert_close(v @ lagrange.force_coefficients(p, q), power)


@MODULES
@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_batch_row_equals_the_single_call_bit_for_bit(n, name):
    for batch, order in itertools.product((1, 7, 65), "CF"):
        assert_rows_are_single_calls(n, batch, order, name)


def assert_rows_are_single_calls(n, batch, order, name):
    rng = np.random.default_rng(17)
    function, count = FUNCTIONS[name]
    p = random_arm(rng, n)
    motion = [np.asarray(x, order=order) for x in random_state(rng, n, (batch,))[:count]]
    together = function(p, *motion)
    for i in range(batch):
        alone = function(p, *(x[i] for x in motion))
        np.testing.assert_array_equal(
            np.asarray(together)[..., i] if name == "energy" else together[i], alone
        )


@MODULES
@pytest.mark.parametrize("batch", [1, 7, 65])
@pytest.mark.parametrize("order", "CF")
def test_an_arm_in_a_batch_of_arms_equals_it_alone_bit_for_bit(n, batch, order):
    rng = np.random.default_rng(18)
    p = random_arm(rng, n, (batch,))
    q, v, a = (np.asarray(x, order=order) for x in random_state(rng, n, (batch,)))
    v_r = np.asarray(rng.normal(size=(batch, 2 * n)), order=order)
    together = lagrange.inverse_dynamics(p, q, v, a, v_r)
    for i in range(batch):
        one = p.arm(i)
        alone = lagrange.inverse_dynamics(one, q[i], v[i], a[i], v_r[i])
        np.testing.assert_array_equal(together[i], alone)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_one_state_broadcasts_against_a_batch_of_arms(name):
    rng = np.random.default_rng(19)
    function, count = FUNCTIONS[name]
    p = random_arm(rng, 3, (7,))
    motion = random_state(rng, 3)[:count]
    repeated = (np.repeat(x[None], 7, axis=0) for x in motion)
    np.testing.assert_allclose(function(p, *motion), function(p, *repeated), rtol=1e-12)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_inputs_are_not_modified(name):
    rng = np.random.default_rng(20)
    function, count = FUNCTIONS[name]
    motion = random_state(rng, 3, (7,))[:count]
    before = [x.copy() for x in motion]
    for x in motion:
        x.setflags(write=False)
    function(random_arm(rng, 3), *motion)
    for x, was in zip(motion, before, strict=True):
        np.testing.assert_array_equal(x, was)


def test_integers_are_taken_as_numbers_not_truncated():
    p = random_arm(np.random.default_rng(21), 3)
    q, zero = np.array([1, 1, 1, 0, 1, 0]), np.zeros(6, dtype=int)
    expected = lagrange.inverse_dynamics(p, 1.0 * q, 1.0 * zero, 1.0 * zero)
    np.testing.assert_array_equal(lagrange.inverse_dynamics(p, q, zero, zero), expected)


@pytest.mark.parametrize("name", FUNCTIONS)
@pytest.mark.parametrize("shape", [(5,), (7, 3), ()])
def test_a_wrong_last_axis_is_refused_with_its_name_and_shape(name, shape):
    rng = np.random.default_rng(22)
    function, count = FUNCTIONS[name]
    first, *others = inspect.signature(function).parameters
    good, p = random_state(rng, 3), random_arm(rng, 3)
    assert first == "p"
    for wrong in range(count):
        motion = [np.ones(shape) if i == wrong else good[i] for i in range(count)]
        with pytest.raises(ValueError) as caught:
            function(p, *motion)
        message = str(caught.value)
        assert message.startswith(f"{others[wrong]} has shape {shape}; its last axis must hold 6")

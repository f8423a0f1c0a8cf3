"""The maps between input forces and generalised forces against their matrices."""

from __future__ import annotations

import dataclasses

import mujoco
import numpy as np
import pytest

from octarm import ArmParameters
from octarm.arm import lagrange
from octarm.arm.actuation import ACTUATIONS, Actuation, GroundedActuation, InternalActuation
from octarm.arm.mjcf import (
    build_model,
    build_slim_model,
    model_path,
    nominal_parameters,
    paper_order,
)
from octarm.checks.validation import arm_with

MODULES = pytest.mark.parametrize("n", [1, 2, 3, 5])
KINDS = pytest.mark.parametrize("kind", ACTUATIONS.values(), ids=ACTUATIONS.keys())
BATCHES = [((), ()), ((), (7,)), ((), (2, 3)), ((7,), (7,)), ((3,), (2, 3)), ((2, 3), (2, 3))]


def random_motion(
    rng: np.random.Generator, n: int, batch: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray]:
    """Coordinates and forces."""
    slide, bend = rng.uniform(0.04, 0.25, (*batch, n)), rng.uniform(-1.5, 1.5, (*batch, n))
    return np.concatenate([slide, bend], axis=-1), rng.uniform(-20, 20, (*batch, 2 * n))


def random_width(rng: np.random.Generator, n: int, batch: tuple[int, ...]) -> np.ndarray:
    return rng.uniform(0.05, 0.12, (*batch, n))


def column_moments(width: np.ndarray, n: int) -> np.ndarray:
    """T: column (a, i) has 1 in row i and +-l/2 in row n + i."""
    out = np.zeros((*width.shape[:-1], 2 * n, 2 * n))
    for i in range(n):
        out[..., i, 2 * i : 2 * i + 2] = 1.0
        out[..., n + i, 2 * i] = 0.5 * width[..., i]
        out[..., n + i, 2 * i + 1] = -0.5 * width[..., i]
    return out


def matrix(kind: type, width: np.ndarray, q: np.ndarray) -> np.ndarray:
    n = q.shape[-1] // 2
    if kind is InternalActuation:
        return column_moments(width, n)
    ones = np.ones((2, n))
    p = ArmParameters(
        mass=ones[0],
        inertia=ones[0],
        width=width,
        stiffness=ones,
        damping=ones,
        rest_length=ones[0],
        gravity=0.0,
    )
    return lagrange.force_coefficients(p, q)


def times(matrix: np.ndarray, x: np.ndarray) -> np.ndarray:
    return np.sum(matrix * x[..., None, :], axis=-1)


def assert_close(actual: np.ndarray, expected: np.ndarray) -> None:
    assert actual.shape == expected.shape
    scale = np.max(np.abs(expected))
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=1e-12 * scale)


@KINDS
@MODULES
def test_force_is_the_matrix_times_the_inputs(kind, n):
    rng = np.random.default_rng(1)
    for widths, states in BATCHES:
        width, (q, tau) = random_width(rng, n, widths), random_motion(rng, n, states)
        assert_close(kind(width).force(q, tau), times(matrix(kind, width, q), tau))


@KINDS
@MODULES
def test_inputs_and_force_invert_each_other(kind, n):
    rng = np.random.default_rng(2)
    for widths, states in BATCHES:
        actuation = kind(random_width(rng, n, widths))
        q, tau = random_motion(rng, n, states)
        assert_close(actuation.inputs(q, actuation.force(q, tau)), tau)
        assert_close(actuation.force(q, actuation.inputs(q, tau)), tau)


@KINDS
@MODULES
@pytest.mark.parametrize("build", [build_model, build_slim_model])
def test_the_motors_of_the_model_exert_the_force_of_the_inputs_in_every_state(kind, n, build):
    rng = np.random.default_rng(3)
    width, (q, tau) = random_width(rng, n, ()), random_motion(rng, n, (500,))
    p = dataclasses.replace(arm_with(n), width=width)
    actuation, model = kind(p.widths), build(p)
    data, (positions, velocities) = mujoco.MjData(model), paper_order(model)
    found = np.empty_like(q)
    for row, q_row, ctrl in zip(found, q, actuation.ctrl(tau), strict=True):
        data.qpos[positions], data.ctrl[:] = q_row, ctrl
        mujoco.mj_forward(model, data)
        row[:] = data.qfrc_actuator[velocities]
    assert_close(found, times(matrix(kind, p.widths, q), tau))


def test_the_bare_file_exerts_f_coeff_tau_where_ctrl_is_tau():
    """With MuJoCo alone: tau, and tau once more for the motors whose names begin with reaction."""
    model = mujoco.MjModel.from_xml_path(str(model_path()))
    data = mujoco.MjData(model)
    q, tau = random_motion(np.random.default_rng(8), 3, (500,))
    p = nominal_parameters()
    inputs = [f"{a}_{i}" for i in (1, 2, 3) for a in (1, 2)]
    motors = [model.actuator(k).name.partition("_")[::2] for k in range(model.nu)]
    assert [kind for kind, _ in motors] == ["push"] * 6 + ["reaction"] * 4
    order = [inputs.index(column) for _, column in motors]
    assert order == [0, 1, 2, 3, 4, 5, 2, 3, 4, 5]
    internal = InternalActuation(p.widths)
    for q_row, tau_row in zip(q, tau, strict=True):
        for i in range(3):
            data.joint(f"s_{i + 1}").qpos = q_row[i]
            data.joint(f"theta_{i + 1}").qpos = q_row[3 + i]
        data.ctrl[:] = tau_row[order]
        forces = []
        for disabled in (0, 1 << 1):  # group 1 holds the reactions
            model.opt.disableactuator = disabled
            mujoco.mj_forward(model, data)
            names = [f"{kind}_{i}" for kind in ("s", "theta") for i in (1, 2, 3)]
            forces.append(np.array([data.joint(name).qfrc_actuator[0] for name in names]))
        assert_close(forces[0], lagrange.force_coefficients(p, q_row) @ tau_row)
        assert_close(forces[1], internal.force(q_row, tau_row))


@KINDS
@MODULES
def test_determinant_is_the_same_power_of_the_width_in_every_state(kind, n):
    rng = np.random.default_rng(4)
    width, (q, _) = random_width(rng, n, ()), random_motion(rng, n, (50,))
    sign = (-1) ** (n * (n + 1) // 2)  # +1 for three modules
    determinants = np.linalg.det(matrix(kind, width, q))
    np.testing.assert_allclose(determinants, sign * np.prod(width), rtol=1e-12)


def test_internal_forces_ignore_the_state_and_act_on_their_own_module_only():
    q, _ = random_motion(np.random.default_rng(5), 3, ())
    actuation = InternalActuation(np.full(3, 0.08))
    for i in range(3):
        tau = np.zeros(6)
        tau[2 * i] = 1.0
        expected = np.zeros(6)
        expected[[i, 3 + i]] = 1.0, 0.04
        np.testing.assert_array_equal(actuation.force(q, tau), expected)


def test_grounded_forces_of_the_last_module_push_every_module_of_a_straight_arm():
    q = np.array([0.1, 0.2, 0.3, 0.0, 0.0, 0.0])
    actuation = GroundedActuation(np.full(3, 0.08))
    force = actuation.force(q, np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0]))
    np.testing.assert_array_equal(force, [2.0, 2.0, 2.0, 0.0, 0.0, 0.0])


@KINDS
@MODULES
@pytest.mark.parametrize("batch", [1, 7, 257])
def test_a_batch_row_equals_the_single_call_bit_for_bit(kind, n, batch):
    for order in ("C", "F"):
        for many_widths in (False, True):
            assert_rows_are_single_calls(kind, n, batch, order, many_widths)


def assert_rows_are_single_calls(kind, n, batch, order, many_widths):
    rng = np.random.default_rng(6)
    width = random_width(rng, n, (batch,) if many_widths else ())
    q, tau = (np.asarray(x, order=order) for x in random_motion(rng, n, (batch,)))

    def results(actuation: Actuation, q: np.ndarray, tau: np.ndarray) -> np.ndarray:
        maps = (actuation.force(q, tau), actuation.inputs(q, tau), actuation.ctrl(tau))
        return np.concatenate(maps, axis=-1)

    together = results(kind(width), q, tau)
    for i in range(batch):
        alone = results(kind(width[i] if many_widths else width), q[i], tau[i])
        np.testing.assert_array_equal(together[i], alone)


@KINDS
def test_inputs_are_not_modified(kind):
    q, tau = random_motion(np.random.default_rng(7), 3, (7,))
    before = q.copy(), tau.copy()
    q.setflags(write=False)
    tau.setflags(write=False)
    actuation = kind(np.full(3, 0.08))
    for f in (actuation.force, actuation.inputs):
        f(q, tau)
    actuation.ctrl(tau)[...] = 0.0
    np.testing.assert_array_equal(q, before[0])
    np.testing.assert_array_equal(tau, before[1])


@KINDS
def test_integers_are_taken_as_numbers_not_truncated(kind):
    actuation = kind(np.full(3, 0.08))
    q, tau = np.array([1, 1, 1, 0, 1, 0]), np.array([1, 0, 2, 0, 3, 1])
    for f in (actuation.force, actuation.inputs):
        np.testing.assert_array_equal(f(q, tau), f(1.0 * q, 1.0 * tau))

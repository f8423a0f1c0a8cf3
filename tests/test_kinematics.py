"""Where the arm is, how that changes with the coordinates, and what a force on the tip does."""
# pyright: reportAttributeAccessIssue=false

import mujoco
import numpy as np
import pytest

from octarm.arm.kinematics import (
    jacobian,
    jacobian_rate,
    plate_axes,
    plate_entries,
    positions,
    tip_force,
)
from octarm.arm.lagrange import potential_force
from octarm.arm.mjcf import build_model, nominal_parameters, paper_order, world_position
from octarm.arm.parameters import ArmParameters
from octarm.arm.recursion import plate_rows

P = nominal_parameters()
H = 1e-30  # f(x + i h d) = f(x) + i h (derivative of f along d) + O(h^2)
MODULES = pytest.mark.parametrize("modules", [1, 3, 6])


def random_q(shape: tuple[int, ...] = (), seed: int = 0, modules: int = 3) -> np.ndarray:
    draw = np.random.default_rng(seed)
    s = draw.uniform(0.05, 0.25, (*shape, modules))
    return np.concatenate([s, draw.uniform(-1.5, 1.5, (*shape, modules))], axis=-1)


def test_straight_modules_add_up_and_a_right_angle_turns_the_next_one():
    q = np.array([0.1, 0.2, 0.3, 0.0, np.pi / 2, 0.7])
    np.testing.assert_allclose(positions(q), [[0.1, 0.0], [0.3, 0.0], [0.3, 0.3]], atol=1e-15)


@MODULES
def test_the_jacobian_and_its_rate_are_derivatives(modules: int):
    q, v = random_q((20,), modules=modules), random_q((20,), seed=1, modules=modules)
    moved = np.repeat(q[:, None].astype(complex), 2 * modules, axis=1)
    moved += 1j * H * np.eye(2 * modules)
    columns = np.moveaxis(positions(moved).imag / H, 1, -1)
    np.testing.assert_allclose(jacobian(q), columns, atol=1e-14)
    rate = jacobian(q + 1j * H * v).imag / H
    np.testing.assert_allclose(jacobian_rate(q, v), rate, atol=1e-13)


@MODULES
def test_axes_are_the_same_as_an_array_and_entry_by_entry(modules: int):
    for q in (random_q(modules=modules), random_q((4,), modules=modules)):
        entries = [np.stack(np.broadcast_arrays(*axis), axis=-1) for axis in plate_entries(q)]
        expected = np.stack(np.broadcast_arrays(*entries), axis=-2)
        np.testing.assert_allclose(plate_axes(q), np.broadcast_to(expected, plate_axes(q).shape))


def test_axes_that_are_kept_follow_coordinates_that_change_in_place():
    q = np.full((4, 6), 0.3)
    before = plate_rows(q)
    assert plate_rows(q.copy()) is before
    q[:, 3] = 0.5
    cos, sin = plate_rows(q)
    np.testing.assert_array_equal(cos[:, 1], np.cos(0.5))
    np.testing.assert_array_equal(sin[:, 1], np.sin(0.5))
    with pytest.raises(ValueError, match="read-only"):
        before[0][0, 1] = 1.0


@MODULES
def test_a_tip_force_does_the_work_of_a_force_on_the_tip(modules: int):
    """Q . dq = f . dp, by complex steps on the tip's position."""
    q, f = random_q((50,), modules=modules), np.array([0.7, -1.9])
    moved = np.repeat(q[:, None].astype(complex), 2 * modules, axis=1)
    j = np.arange(2 * modules)
    moved[:, j, j] += 1e-30j
    dp = positions(moved)[..., -1, :].imag / 1e-30
    np.testing.assert_allclose(tip_force(q, *f), dp @ f, atol=1e-14)


def test_a_tip_force_is_what_mujoco_makes_of_a_force_at_the_tip():
    model = build_model()
    data = mujoco.MjData(model)
    qpos, qvel = paper_order(model)
    body, site = model.body("module_3").id, model.site("tip").id
    for q in random_q((20,)):
        data.qpos[qpos] = q
        mujoco.mj_forward(model, data)
        for f in ([1.0, 0.0], [0.0, 1.0], [-2.0, 3.0]):
            force, out = world_position(np.array(f)), np.zeros(model.nv)
            point = data.site_xpos[site]
            mujoco.mj_applyFT(model, data, force, np.zeros(3), point, body, out)
            np.testing.assert_allclose(tip_force(q, *f), out[qvel], atol=1e-13)


def test_the_weight_of_a_load_is_a_force_on_the_tip():
    q, load = random_q((30,)), 0.4
    mass = P.mass + np.array([0.0, 0.0, load])
    loaded = ArmParameters(**{**P.to_dict(), "mass": mass})
    weight = potential_force(P, q) - potential_force(loaded, q)
    np.testing.assert_allclose(weight, tip_force(q, load * P.gravity, 0.0), atol=1e-13)


def test_a_tip_force_has_the_same_bits_in_a_batch():
    q = random_q((9,))
    fx, fy = np.random.default_rng(1).normal(size=(2, 9))
    batch = tip_force(np.asfortranarray(q), fx, fy)
    for i in range(9):
        np.testing.assert_array_equal(tip_force(q[i], float(fx[i]), float(fy[i])), batch[i])

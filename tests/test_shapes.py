"""The shapes of the drawn arm agree with the lumped model."""

import numpy as np
import pytest
from recordings import swinging

from octarm.arm.lagrange import positions
from octarm.arm.mjcf import world_position
from octarm.recordings import shapes


@pytest.mark.parametrize("modules", [1, 5])
def test_the_drawn_arm_is_smooth_and_ends_where_the_lumped_arm_ends(modules):
    q = swinging(modules, rows=100).q
    curve = shapes.smooth_arm(q)
    ends = world_position(positions(q))
    np.testing.assert_allclose(curve[:, :, -1], ends, atol=1e-12)
    np.testing.assert_allclose(curve[:, 1:, 0], ends[:, :-1], atol=1e-12)
    steps = np.diff(curve, axis=2)
    steps /= np.linalg.norm(steps, axis=-1, keepdims=True)
    turns = np.sum(steps[:, :-1, -1] * steps[:, 1:, 0], axis=-1)
    assert np.all(turns > np.cos(0.1))  # chords of 12 points: no kink between modules
    np.testing.assert_array_equal(shapes.tip(q), ends[:, -1])
    np.testing.assert_array_equal(shapes.skeleton(q)[:, 1:], ends)


def test_the_columns_differ_in_length_as_the_model_says():
    q = swinging(rows=100).q
    lengths = [
        np.linalg.norm(np.diff(shapes.smooth_arm(q, side * 0.08), axis=2), axis=-1).sum(axis=-1)
        for side in (-0.5, 0.5)
    ]
    np.testing.assert_allclose(lengths[0] - lengths[1], 0.08 * q[:, 3:], atol=2e-4)


def test_pieces_lie_along_the_curve():
    q = swinging(rows=10).q
    for pieces, count in ((shapes.backbone(q, n), n) for n in (shapes.TUBE_PIECES, shapes.RIBS)):
        along = np.stack(
            [np.sin(pieces.angles), 0.0 * pieces.angles, np.cos(pieces.angles)], axis=-1
        )
        curve = shapes.smooth_arm(q, points=count + 1)
        steps = np.diff(curve, axis=2).reshape(10, -1, 3)
        np.testing.assert_allclose(np.cross(along, steps), 0.0, atol=1e-12)
        assert np.all(np.sum(along * steps, axis=-1) > 0.0)
        middle = 0.5 * (curve[:, :, 1:] + curve[:, :, :-1]).reshape(10, -1, 3)
        np.testing.assert_allclose(pieces.centers, middle, atol=1e-12)


def test_columns_come_in_the_order_of_tau():
    centers = shapes.columns(np.array([[0.1, 0.1, 0.0, 0.0]]), 0.08).centers
    sides = centers.reshape(2, 2, shapes.COLUMN_PIECES, 3)[..., 0]
    np.testing.assert_allclose(sides[:, 0], -0.04)
    np.testing.assert_allclose(sides[:, 1], 0.04)


def test_plates_face_along_the_arm():
    q = np.array([0.1, 0.1, 0.1, 0.3, -0.5, 0.2])
    angles = shapes.plates(q).angles
    phi = np.cumsum(q[3:])
    expected = world_position(np.stack([np.cos(phi), np.sin(phi)], axis=-1))
    axis = np.stack([np.sin(angles), 0.0 * angles, np.cos(angles)], axis=-1)
    np.testing.assert_allclose(axis, expected, atol=1e-12)


def test_force_arrows_do_the_work_of_the_generalised_force():
    """Each pair of a coordinate's forces does the work Q_j dq_j when only that coordinate moves."""
    draw = np.random.default_rng(2)
    q, force = draw.normal(0.0, 0.3, (1, 6)), draw.normal(size=(1, 6))
    step = 1e-6
    for j in range(6):
        own = np.zeros((1, 6))
        own[0, j] = force[0, j]
        origins, forces = shapes.force_arrows(q, own, 0.05)
        moved, _ = shapes.force_arrows(q + step * np.eye(6)[j], own, 0.05)
        work = np.sum(forces * (moved - origins)) / step
        assert work == pytest.approx(force[0, j], rel=1e-4)

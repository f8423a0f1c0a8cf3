"""Chattering against Fourier series of the held force, and against its own control rate."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy import linalg

from octarm.metrics.forces import Chattering
from octarm.metrics.metric import CORNER, Settings


def begun(like: np.ndarray, period: float, corner: float = CORNER) -> Chattering:
    return Chattering({"force": like}, Settings(control_period=period, corner=corner))


def measure(force: np.ndarray, period: float, corner: float = CORNER, settle: float = 0.5) -> dict:
    """The measures of one force in time, shape (T,), once the filter has settled."""
    rows = force[:, None]
    chattering = begun(rows[0], period, corner)
    begin = round(settle / period)
    chattering.update({"force": rows[:begin]}, False)
    chattering.update({"force": rows[begin:]}, True)
    return {name: value.item() for name, value in chattering.result().items()}


def gain(f: np.ndarray | float, corner: float) -> np.ndarray:
    return np.square(f) / (np.square(f) + corner**2)


def square_wave_rms(half_period: float, corner: float) -> float:
    """What is left of a wave between -1 and 1: harmonics 4 / (pi n) for odd n."""
    n = np.arange(1, 400_001, 2)
    parts = (4.0 / (np.pi * n) * gain(n / (2.0 * half_period), corner)) ** 2 / 2.0
    rest = 4.0 / (np.pi**2 * (n[-1] + 1.0))  # of the sum of 8 / (pi n)^2, to first order
    return np.sqrt(parts.sum() + rest)


def held_sine_rms(f: float, period: float, corner: float) -> float:
    """Of a unit sine that is held: a line at f + k / period for every whole k."""
    lines = f + np.arange(-100_000, 100_001) / period
    return np.sqrt(np.sum((np.sinc(lines * period) * gain(lines, corner)) ** 2) / 2.0)


@pytest.mark.parametrize("period", [1e-2, 1e-3, 1e-4])
@pytest.mark.parametrize("corner", [5.0, 50.0])
def test_a_force_that_switches_at_every_instant(period, corner):
    force = np.where(np.arange(round(2.0 / period)) % 2, 1.0, -1.0)
    found = measure(force, period, corner)
    assert found["chattering"] == pytest.approx(square_wave_rms(period, corner), rel=1e-6)
    # The variation grows with the control rate, the chattering tends to 1.
    assert found["total_variation"] == pytest.approx(2.0 / period)
    assert found["switching_activity"] == pytest.approx(2.0)
    assert found["control_rate"] == pytest.approx(1.0 / period)
    assert 1.0 - found["chattering"] < (2.0 * np.pi * corner * period) ** 2 / 6.0


@pytest.mark.parametrize("corner", [5.0, 50.0])
def test_a_square_wave_is_the_same_at_every_rate(corner):
    expected = square_wave_rms(0.05, corner)
    for period in (1e-2, 5e-3, 1e-3, 5e-4, 1e-4):
        steps = round(0.05 / period)
        force = np.where(np.arange(round(2.0 / period)) // steps % 2, 1.0, -1.0)
        found = measure(force, period, corner, settle=1.0)
        assert found["chattering"] == pytest.approx(expected, rel=1e-6)
        assert found["total_variation"] == pytest.approx(40.0)  # 20 jumps of 2 a second
        assert found["switching_activity"] == pytest.approx(40.0 * period)


@pytest.mark.parametrize("frequency", [0.5, 5.0, 50.0, 200.0])
@pytest.mark.parametrize("period", [1e-3, 5e-4])
def test_a_sine_passes_by_the_gain_of_the_filter(frequency, period):
    t = period * np.arange(round(4.5 / period))
    found = measure(3.0 * np.sin(2.0 * np.pi * frequency * t), period)["chattering"]
    assert found == pytest.approx(3.0 * held_sine_rms(frequency, period, CORNER), rel=1e-5)


def test_the_stairs_of_a_smooth_force_vanish_with_the_period():
    left = []
    for period in (2e-3, 1e-3, 5e-4, 2.5e-4, 1.25e-4):
        t = period * np.arange(round(4.5 / period))
        left.append(measure(np.sin(2.0 * np.pi * 5.0 * t), period)["chattering"])
    true = gain(5.0, CORNER) / np.sqrt(2.0)
    errors = np.array(left) - true
    assert np.all(errors[1:] < 0.55 * errors[:-1]) and errors[-1] < 0.01 * true


def test_half_of_the_corner_passes_and_motion_does_not():
    t = 1e-4 * np.arange(45_000)
    at_corner, motion = (measure(np.sin(2 * np.pi * f * t), 1e-4) for f in (CORNER, 0.5))
    assert at_corner["chattering"] == pytest.approx(0.5 / np.sqrt(2.0), rel=1e-3)
    assert motion["chattering"] < 1.2e-4


def test_a_constant_force_does_not_chatter():
    found = measure(np.full(5000, 7.3), 5e-4)
    assert found["chattering"] == found["total_variation"] == found["switching_activity"] == 0.0


@given(
    st.lists(st.floats(-5.0, 5.0), min_size=2, max_size=20),
    st.floats(1.0, 300.0),
    st.floats(1e-4, 2e-2),
)
@example([0.0, 1.0], 280.0, 1.0 / 64.0)
@settings(max_examples=20, deadline=None)
def test_any_staircase_against_a_dense_simulation(levels, corner, period):
    fine = 500  # substeps of a period, for the trapezoidal rule
    w = 2.0 * np.pi * corner
    flow, entry = np.array([[-2.0 * w, -w * w], [1.0, 0.0]]), np.array([1.0, 0.0])
    output = np.array([-2.0 * w, -w * w])  # y = u + output . x is u filtered by p^2 / (p + w)^2
    A = linalg.expm(flow * period / fine)
    rest = -np.linalg.solve(flow, entry)
    state = rest * levels[0]
    squares = []
    for level in levels:
        path = [state]
        for _ in range(fine):
            path.append(rest * level + A @ (path[-1] - rest * level))
        y = level + np.array(path) @ output
        squares.append(np.trapezoid(y * y, dx=1.0 / fine))
        state = path[-1]
    chattering = begun(np.zeros(1), period, corner)
    chattering.update({"force": np.array(levels)[:, None]}, True)
    expected = np.sqrt(np.mean(squares))
    # In a period y = exp(-wt) (a - b t). With steps of h the trapezoidal rule gives the root mean
    # square of any such y to within (wh)^2 + 1 / fine^2, relatively: .71 (wh)^2 for long periods
    # (17 / 12 of the square, by Euler and Maclaurin), 1 / fine^2 for short ones with a zero inside.
    allowed = 1.01 * ((w * period / fine) ** 2 + 1.0 / fine**2)
    scale = 1e-12 * max(map(abs, levels))
    result = chattering.result()["chattering"]
    np.testing.assert_allclose(result, expected, rtol=allowed, atol=scale)


def test_nothing_is_said_without_a_row_of_the_steady_regime():
    chattering = begun(np.zeros(3), 1e-3)
    chattering.update({"force": np.ones((10, 3))}, False)
    found = chattering.result()
    for name in ("chattering", "total_variation", "switching_activity"):
        assert found[name].shape == (3,) and np.all(np.isnan(found[name]))


def test_the_jump_at_the_start_is_no_chattering():
    force = np.concatenate([np.zeros(10), np.full(3990, 5.0)])
    assert measure(force, 5e-4)["chattering"] < 1e-12

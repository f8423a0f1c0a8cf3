"""Desired motions: their derivatives match, and they are what their names say."""

import numpy as np
import pytest

from octarm.arm.lagrange import equilibrium
from octarm.arm.mjcf import nominal_parameters
from octarm.references import (
    REFERENCES,
    MultiSine,
    SetPoint,
    Sine,
    SmoothStep,
    Spline,
    named_reference,
)

ARM = nominal_parameters()
REST = equilibrium(ARM)
NAMES = [name for name in REFERENCES if name != "file"]  # which needs a file


@pytest.mark.parametrize("name", NAMES)
def test_velocity_and_acceleration_are_the_derivatives(name: str):
    motion = named_reference(name, REST)
    h = 1e-5
    for t in (0.11, 0.7, 1.03, 2.9):
        before, now, after = motion(t - h), motion(t), motion(t + h)
        np.testing.assert_allclose(now.v, (after.q - before.q) / (2 * h), atol=1e-8)
        np.testing.assert_allclose(now.a, (after.v - before.v) / (2 * h), atol=1e-7)


@pytest.mark.parametrize("name", [name for name in NAMES if name != "tip"])  # of one arm
@pytest.mark.parametrize("modules", [1, 2, 5])
def test_any_number_of_modules_and_any_batch(name: str, modules: int):
    rest = np.zeros((4, 2 * modules))
    for part in named_reference(name, rest)(0.3):
        assert part.shape == rest.shape


def test_the_default_is_the_sine_of_the_paper_on_two_bends():
    motion = named_reference("sine", REST)
    quarter = motion(0.5)
    np.testing.assert_allclose(quarter.q - REST, [0, 0, 0, 0.35, 0.25, 0], atol=1e-15)
    np.testing.assert_allclose(motion(0.0).v, np.pi * np.array([0, 0, 0, 0.35, 0.25, 0]))


def test_a_smooth_step_rests_before_and_after_and_passes_half_way():
    motion = SmoothStep(start=np.zeros(2), goal=np.array([1.0, -2.0]), begin=1.0, duration=2.0)
    for t, share in ((0.0, 0.0), (1.0, 0.0), (2.0, 0.5), (3.0, 1.0), (9.0, 1.0)):
        np.testing.assert_allclose(motion(t).q, share * motion.goal, atol=1e-15)
    for t in (0.5, 1.0, 3.0, 9.0):
        np.testing.assert_array_equal(motion(t).v, 0.0)
        np.testing.assert_array_equal(motion(t).a, 0.0)


def test_a_spline_is_exact_for_a_quintic_and_rests_outside():
    t = np.array([-1.0, -0.3, 0.2, 0.5, 0.9, 1.6, 2.0])
    quintic = np.polynomial.Polynomial([0.3, -1.0, 0.5, 2.0, -0.7, 0.2])
    motion = Spline(times=t, points=np.stack([quintic(t), -2.0 * quintic(t)], axis=1))
    for now in (-1.0, 0.0, 0.7, 2.0):
        for part, order in zip(motion(now), range(3), strict=True):
            exact = quintic.deriv(order)(now) if order else quintic(now)
            np.testing.assert_allclose(part, [exact, -2.0 * exact], rtol=1e-9)
    for now, end in ((-5.0, -1.0), (2.1, 2.0)):
        np.testing.assert_array_equal(motion(now).q, motion(end).q)
        assert not motion(now).v.any() and not motion(now).a.any()


def test_a_multi_sine_is_the_sum_of_its_tones():
    one = Sine(center=REST, amplitude=np.ones(6), frequency=1.0)
    two = Sine(center=np.zeros(6), amplitude=2 * np.ones(6), frequency=0.3, phase=0.4)
    for total, a, b in zip(MultiSine(tones=(one, two))(0.7), one(0.7), two(0.7), strict=True):
        np.testing.assert_array_equal(total, a + b)


def test_a_set_point_rests():
    desired = SetPoint(q=REST)(3.0)
    np.testing.assert_array_equal(desired.q, REST)
    assert not desired.v.any() and not desired.a.any()


def test_bad_values_are_refused_in_one_sentence():
    with pytest.raises(ValueError, match="unknown reference 'sin', did you mean 'sine'"):
        named_reference("sin", REST)
    with pytest.raises(ValueError, match="amplitude holds nan; it must be finite"):
        Sine(center=REST, amplitude=np.full(6, np.nan), frequency=1.0)
    with pytest.raises(ValueError, match="positive time"):
        SmoothStep(start=REST, goal=REST, duration=0.0)
    with pytest.raises(ValueError, match=r"times have shape \(5,\); they must be at least 6"):
        Spline(times=np.arange(5.0), points=np.zeros((5, 6)))
    with pytest.raises(ValueError, match="one after another"):
        Spline(times=np.array([0.0, 1.0, 2.0, 2.0, 3.0, 4.0]), points=np.zeros((6, 6)))
    with pytest.raises(ValueError, match=r"points have shape \(7, 6\); they must be \(6, 2N\)"):
        Spline(times=np.arange(6.0), points=np.zeros((7, 6)))
    with pytest.raises(ValueError, match="at least one"):
        MultiSine(tones=())

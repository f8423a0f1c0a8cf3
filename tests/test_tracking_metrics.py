"""Errors, settling, overshoot and tip error against closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from octarm.arm.lagrange import positions
from octarm.arm.tip import tip
from octarm.metrics.metric import Settings, default_band
from octarm.metrics.tracking import (
    DWELL,
    Overshoot,
    Settling,
    TipError,
    TrackingError,
)

STEP = 1e-3
BAND = 0.01


def times(duration: float = 6.0, step: float = STEP) -> np.ndarray:
    return step * np.arange(round(duration / step))


def errors_of(error: np.ndarray) -> dict[str, np.ndarray]:
    measure = TrackingError({"q": error[0]}, Settings(control_period=STEP))
    measure.update({"error": error, "squared_error": error * error}, True)
    return measure.result()


def overshoot_of(t: np.ndarray, q: np.ndarray, q_d: np.ndarray) -> dict[str, float]:
    q, q_d, late = q[:, None], q_d[:, None], t >= 2.0
    settings = Settings(control_period=STEP, band=BAND)
    measure = Overshoot({"q": q[0], "q_d": q_d[0]}, settings)
    measure.update({"q": q[~late], "q_d": q_d[~late]}, False)
    measure.update({"q": q[late], "q_d": q_d[late]}, True)
    return {name: value.item() for name, value in measure.result().items()}


def settling_of(error: np.ndarray, step: float = STEP, band: float = BAND) -> tuple[float, float]:
    measure = Settling({"q": np.zeros(1)}, Settings(control_period=step, band=band))
    measure.update({"squared_error": np.square(error)[:, None]}, False)
    found = measure.result()
    return found["settling_time"].item(), found["settled"].item()


def test_the_rms_of_a_sine_is_its_amplitude_over_root_two():
    error = np.stack([0.3 * np.sin(np.pi * times()), np.full(6000, -0.2)], axis=-1)
    found = errors_of(error)
    np.testing.assert_allclose(found["rms_error"], [0.3 / np.sqrt(2.0), 0.2], rtol=1e-12)
    np.testing.assert_allclose(found["peak_error"], [0.3, 0.2], rtol=1e-15)
    np.testing.assert_allclose(found["steady_error"], [0.0, -0.2], atol=1e-15)


@pytest.mark.parametrize("step", [1e-2, 1e-3, 1e-4])
def test_the_rms_does_not_depend_on_the_rate(step):
    error = (0.1 + 0.3 * np.sin(np.pi * times(6.0, step)))[:, None]
    found = errors_of(error)
    np.testing.assert_allclose(found["rms_error"], np.hypot(0.1, 0.3 / np.sqrt(2.0)), rtol=1e-11)
    np.testing.assert_allclose(found["steady_error"], 0.1, rtol=1e-11)


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=20))
def test_the_peak_is_exactly_the_largest_error(errors):
    peak = errors_of(np.array(errors)[:, None])["peak_error"].item()
    assert peak == max(map(abs, errors)) or max(map(abs, errors)) < 1e-150


@pytest.mark.parametrize("gain", [1.03, 0.97, 1.0])
@pytest.mark.parametrize("centre", [0.0, 0.1231, -2.0])
def test_a_sine_followed_with_a_gain(gain, centre):
    t = times()
    sine = 0.02 * np.sin(np.pi * t)
    found = overshoot_of(t, centre + gain * sine, centre + sine)
    percent = pytest.approx(100.0 * (gain - 1.0), abs=1e-9)
    assert found["overshoot"] == percent and found["undershoot"] == percent
    assert np.isnan(found["step_overshoot"])


@given(st.floats(0.5, 1.5), st.floats(-0.3, 0.3), st.floats(-1.0, 1.0), st.floats(0.01, 2.0))
@settings(max_examples=40, deadline=None)
def test_a_shifted_sine_exceeds_one_end_and_misses_the_other(gain, shift, centre, amplitude):
    t = times()
    sine = amplitude * np.sin(np.pi * t)
    found = overshoot_of(t, centre + shift * amplitude + gain * sine, centre + sine)
    ends = 100.0 * (gain - 1.0 + shift), 100.0 * (gain - 1.0 - shift)
    assert found["overshoot"] == pytest.approx(max(ends), abs=1e-9)
    assert found["undershoot"] == pytest.approx(min(ends), abs=1e-9)


def test_about_zero_it_is_the_usual_definition():
    t, draw = times(), np.random.default_rng(1)
    q, q_d = draw.normal(size=len(t)), 0.7 * np.sin(np.pi * t)
    late = t >= 2.0
    usual = 100.0 * (np.max(np.abs(q[late])) / np.max(np.abs(q_d[late])) - 1.0)
    assert overshoot_of(t, q, q_d)["overshoot"] == pytest.approx(usual)


def test_what_happens_while_reaching_is_no_overshoot():
    t = times()
    q_d = 0.3 * np.sin(np.pi * t)
    assert overshoot_of(t, np.where(t < 2.0, 50.0, q_d), q_d)["overshoot"] == 0.0


def test_a_reference_that_stands_still_has_no_overshoot():
    t = times()
    found = overshoot_of(t, 0.3 + 0.005 * np.sin(t), np.full_like(t, 0.3))
    assert all(np.isnan(value) for value in found.values())  # the step is within the band, too


@pytest.mark.parametrize("goal", [0.4, -0.4])
@pytest.mark.parametrize("damping", [0.2, 0.5, 0.7])
def test_the_step_response_of_an_oscillator(goal, damping):
    t, w = times(), 15.0
    fast = w * np.sqrt(1.0 - damping**2)
    swing = np.cos(fast * t) + damping * w / fast * np.sin(fast * t)
    q = 0.12 + goal * (1.0 - np.exp(-damping * w * t) * swing)
    found = overshoot_of(t, q, np.full_like(t, 0.12 + goal))
    exact = 100.0 * np.exp(-damping * w * np.pi / fast)
    assert found["step_overshoot"] == pytest.approx(exact, abs=0.01)
    assert np.isnan(found["overshoot"]) and np.isnan(found["undershoot"])


def test_a_step_that_is_never_completed_is_undershot():
    t = times()
    found = overshoot_of(t, 0.9 * (1.0 - np.exp(-5.0 * t)), np.ones_like(t))
    assert found["step_overshoot"] == pytest.approx(-10.0, abs=1e-9)


@given(st.floats(0.02, 0.5), st.floats(1.1, 50.0), st.sampled_from([-1.0, 1.0]))
@settings(max_examples=50, deadline=None)
def test_a_first_order_response_settles_when_it_should(constant, ratio, sign):
    time, settled = settling_of(sign * BAND * ratio * np.exp(-times() / constant))
    assert settled == 1.0
    assert -1e-9 <= time - constant * np.log(ratio) <= STEP * (1.0 + 1e-9)


def test_an_error_that_leaves_the_band_again_settles_only_after_that():
    error = np.where((times() > 3.0) & (times() < 3.1), -1.0, 0.0)
    assert settling_of(error)[0] == pytest.approx(3.1, abs=1.1 * STEP)


def test_what_never_settles_has_no_settling_time():
    for error in (
        np.full(6000, 1.1 * BAND),
        0.3 * np.sin(np.pi * times()),  # within the band now and then
        np.where(times() < 6.0 - 0.9 * DWELL, 1.0, 0.0),  # too late to tell
        np.zeros(round(0.9 * DWELL / STEP)),  # too short to tell
    ):
        time, settled = settling_of(error)
        assert np.isnan(time) and settled == 0.0


def test_the_band_has_to_hold_for_exactly_the_dwell():
    for step in (1e-3, 5e-4, 1.0 / 3000.0, 7e-4):
        rows = int(np.ceil(DWELL / step - 1e-6))
        error = np.concatenate([np.ones(100), np.zeros(rows)])
        assert settling_of(error, step) == (pytest.approx(100 * step), 1.0)
        assert settling_of(error[:-1], step)[1] == 0.0


def test_an_arm_that_is_always_within_the_band_has_settled_at_zero():
    assert settling_of(np.full(2000, BAND)) == (0.0, 1.0)


def test_the_default_band_is_a_millimetre_and_a_degree_or_so():
    np.testing.assert_array_equal(default_band(["m", "m", "rad", "rad"]), [1e-3, 1e-3, 0.02, 0.02])


@pytest.mark.parametrize("modules", [1, 2, 3, 6])
def test_the_tip_is_that_of_the_analytic_model(modules):
    draw = np.random.default_rng(modules)
    q = draw.uniform(-4.0, 4.0, size=(500, 2 * modules))
    x, y = tip(q)
    np.testing.assert_allclose(x, positions(q)[:, -1, 0], atol=3e-14)
    np.testing.assert_allclose(y + np.zeros(500), positions(q)[:, -1, 1], atol=3e-14)


def test_the_tip_at_half_turns():
    for turn in (np.pi, -np.pi, np.pi / 2, 3 * np.pi):
        q = np.array([0.2, 0.3, turn, 0.0])
        np.testing.assert_allclose(np.array(tip(q)), positions(q)[-1], atol=1e-16)


def test_tip_errors_of_a_stretched_and_of_a_turned_arm():
    t = times()
    q_d = np.tile([0.1, 0.2, 0.3, 0.2, 0.0, 0.0], (len(t), 1))
    longer, turned = q_d.copy(), q_d.copy()
    longer[:, 2] += 0.03 * np.sin(np.pi * t)
    turned[:, 3] += 0.1 * np.sign(np.sin(np.pi * t) + 1e-9)
    for q, rms, peak in (
        (longer, 0.03 / np.sqrt(2.0), 0.03),
        (turned, 2.0 * 0.5 * np.sin(0.05), 2.0 * 0.5 * np.sin(0.05)),  # chord of what hangs there
    ):
        for reference in (q_d, q_d[:1].repeat(len(t), axis=0)):
            measure = TipError({"q": q[0]}, Settings(control_period=STEP))
            measure.update({"q": q, "q_d": reference}, True)
            found = measure.result()
            np.testing.assert_allclose(found["tip_rms_error"], rms, rtol=1e-12)
            np.testing.assert_allclose(found["tip_peak_error"], peak, rtol=1e-12)
            assert found["tip_rms_error"].shape == ()

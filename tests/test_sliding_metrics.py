"""Reaching, residence and violations for sliding variables of known course."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from octarm.metrics.metric import Settings
from octarm.metrics.sliding import Sliding

STEP = 1e-3


def measure(s: np.ndarray, phi: float | None = None, step: float = STEP) -> dict[str, float]:
    rows, t = s[:, None], step * np.arange(len(s))
    sliding = Sliding({"s": rows[0]}, Settings(control_period=step, layer=phi))
    for late in (False, True):
        now = (t >= 2.0) == late
        if now.any():
            sliding.update({"t": t[now], "s": rows[now]}, late)
    return {name: value.item() for name, value in sliding.result().items()}


def times(duration: float = 4.0) -> np.ndarray:
    return STEP * np.arange(round(duration / STEP))


@given(st.floats(0.05, 0.5), st.floats(1.1, 30.0), st.sampled_from([-1.0, 1.0]))
@settings(max_examples=50, deadline=None)
def test_an_exponential_reaches_its_layer_when_it_should(constant, ratio, sign):
    found = measure(sign * 0.2 * ratio * np.exp(-times() / constant), phi=0.2)
    late = found["reaching_time"] - constant * np.log(ratio)
    assert -1e-9 <= late <= STEP * (1 + 1e-9)
    assert found["sliding_violations"] == 0.0
    assert found["layer_share"] == 1.0


@pytest.mark.parametrize("phi", [None, 0.0])
def test_without_a_layer_the_first_change_of_sign_counts(phi):
    found = measure(0.7 - times(), phi)
    assert found["reaching_time"] == pytest.approx(0.7, abs=1.01 * STEP)
    assert ("layer_share" in found) == (phi is not None)


def test_a_layer_that_was_crossed_between_two_instants_was_reached():
    s = np.where(times() < 1.0, 3.0, -3.0)
    assert measure(s, phi=0.1)["reaching_time"] == 1.0
    assert measure(s, phi=0.1)["layer_share"] == 0.0


@pytest.mark.parametrize("phi", [None, 0.5])
def test_a_layer_that_is_never_reached_has_no_reaching_time(phi):
    found = measure(1.0 + 0.1 * np.cos(times()), phi)
    assert np.isnan(found["reaching_time"])


def test_who_begins_inside_has_reached_it_at_once():
    found = measure(0.1 * np.sin(10.0 * times()), phi=0.2)
    assert (found["reaching_time"], found["layer_share"]) == (0.0, 1.0)
    assert np.isnan(found["sliding_violations"])  # it was never outside
    assert measure(np.zeros(100))["reaching_time"] == 0.0


def test_outside_the_layer_a_wave_grows_half_of_the_time():
    s = 2.0 + np.sin(2.0 * np.pi * times())
    assert measure(s, phi=0.5)["sliding_violations"] == pytest.approx(0.5, abs=2 * STEP)
    assert measure(-s, phi=0.5)["sliding_violations"] == pytest.approx(0.5, abs=2 * STEP)


def test_growth_counts_only_in_periods_that_begin_outside():
    s = np.array([0.0, 5.0, 0.0, 5.0, 4.0, 4.5, 3.0])  # outside: 5, 5, 4, 4.5 (3 has no end)
    assert measure(s, phi=1.0)["sliding_violations"] == pytest.approx(1.0 / 4.0)


@pytest.mark.parametrize("width", [0.2, 0.5, 0.9])
def test_the_share_of_time_in_the_layer(width):
    found = measure(np.sin(2.0 * np.pi * times()), phi=width)
    assert found["layer_share"] == pytest.approx(2.0 / np.pi * np.arcsin(width), abs=3 * STEP)

"""Measures against closed forms."""

import numpy as np
import pytest

from octarm.metrics import Effort, TrackingError


def sine(duration: float = 6.0, step: float = 0.001) -> tuple[np.ndarray, np.ndarray]:
    t = step * np.arange(round(duration / step))
    return t, np.stack([0.3 * np.sin(np.pi * t), np.full_like(t, -0.2)], axis=-1)


def test_the_rms_of_a_sine_is_its_amplitude_over_root_two():
    t, error = sine()
    measure = TrackingError()
    measure.update(t, error)
    result = measure.result()
    np.testing.assert_allclose(result["rms_error"], [0.3 / np.sqrt(2.0), 0.2], rtol=1e-12)
    np.testing.assert_allclose(result["peak_error"], [0.3, 0.2], rtol=1e-6)


def test_the_reaching_phase_does_not_count():
    t, error = sine()
    error[t < 2.0] = 1e6
    measure = TrackingError()
    measure.update(t, error)
    assert measure.result()["peak_error"][0] <= 0.3


@pytest.mark.parametrize("size", [1, 7, 1999, 100_000])
def test_cutting_into_blocks_changes_nothing_but_rounding(size: int):
    t, error = sine()
    whole, cut, effort = TrackingError(), TrackingError(), Effort()
    whole.update(t, error)
    for k in range(0, len(t), size):
        cut.update(t[k : k + size], error[k : k + size])
        effort.update(error[k : k + size])
    for name, value in whole.result().items():
        np.testing.assert_allclose(cut.result()[name], value, rtol=1e-12)
    np.testing.assert_allclose(effort.result()["effort"], np.sqrt(np.mean(error**2, axis=0)))


def test_a_run_that_is_too_short_has_no_error_number():
    t, error = sine(duration=1.0)
    measure = TrackingError()
    measure.update(t, error)
    assert np.all(np.isnan(measure.result()["rms_error"]))
    assert measure.result()["rms_error"].shape == (2,)


def test_batches_keep_their_axes():
    t, error = sine()
    measure = TrackingError()
    measure.update(t, np.repeat(error[:, None], 4, axis=1))
    assert measure.result()["rms_error"].shape == (4, 2)

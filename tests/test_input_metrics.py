"""Effort, saturation, work and energy against closed forms."""

from typing import Any

import numpy as np
import pytest

from octarm.metrics.forces import ForceUse, InputUse
from octarm.metrics.metric import Accumulator, Settings

STEP = 1e-3


def times(duration: float = 4.0, step: float = STEP) -> np.ndarray:
    return step * np.arange(round(duration / step) + 1)


def used(kind: type[Accumulator], limit: Any = np.inf, **rows: np.ndarray) -> dict[str, np.ndarray]:
    """What an accumulator makes of rows."""
    first = {name: array[0] for name, array in rows.items()}
    use = kind(first, Settings(control_period=STEP, input_range=(-np.asarray(limit), limit)))
    use.update(rows, True)
    return use.result()


def work_of(q: np.ndarray, force: np.ndarray) -> tuple[float, float]:
    found = used(ForceUse, q=q[:, None], force=force[:, None])
    return found["work"].item(), found["energy"].item()


def test_effort_and_peak_of_a_sine():
    tau = np.stack([3.0 * np.sin(np.pi * times()[:-1]), np.full(4000, -2.0)], axis=-1)
    found = used(InputUse, tau=tau)
    np.testing.assert_allclose(found["effort"], [3.0 / np.sqrt(2.0), 2.0], rtol=1e-12)
    np.testing.assert_allclose(found["peak_input"], [3.0, 2.0], rtol=1e-12)
    np.testing.assert_array_equal(found["saturation_share"], 0.0)  # there is no limit


def test_the_share_of_saturated_periods_of_a_clipped_sine():
    tau = np.clip(3.0 * np.sin(np.pi * times()[:-1]), -1.2, 1.2)
    tau = np.stack([tau, tau, tau], axis=-1)
    found = used(InputUse, [1.2, 1.2000001, 1.1], tau=tau)
    shares = [1.0 - 2.0 / np.pi * np.arcsin(1.2 / 3.0), 0.0, 1.0 - 2.0 / np.pi * np.arcsin(1.1 / 3)]
    np.testing.assert_allclose(found["saturation_share"], shares, atol=2e-3)


def test_saturation_is_counted_beyond_any_number_of_rows():
    use = InputUse({"tau": np.zeros(2)}, Settings(control_period=STEP, input_range=(-1.0, 1.0)))
    for _ in range(7):
        use.update({"tau": np.tile([1.0, -0.5], (1000, 1))}, True)
    np.testing.assert_array_equal(use.result()["saturation_share"], [1.0, 0.0])


def test_a_constant_force_does_the_work_force_times_way():
    t = times(3.0)
    work, energy = work_of(0.2 * np.sin(np.pi * t), np.full_like(t, -5.0))
    assert work == pytest.approx(0.0, abs=1e-12)  # back where it began
    assert energy == pytest.approx(5.0 * 0.2 * 6.0, rel=1e-6)  # 6 ways of 0.2, there and back


def test_the_work_of_a_held_force_is_exact_for_long_periods():
    q, force = np.array([0.0, 1.0, 0.5, 2.0]), np.array([2.0, -3.0, 4.0, 1e9])
    assert work_of(q, force) == (2.0 + 1.5 + 6.0, 2.0 + 1.5 + 6.0)
    assert work_of(q, -force) == (-9.5, 9.5)


@pytest.mark.parametrize("step", [1e-3, 5e-4])
def test_a_spring_takes_nothing_and_a_damper_all(step):
    t = times(4.0, step)
    q, v = 0.3 * np.sin(np.pi * t), 0.3 * np.pi * np.cos(np.pi * t)
    work, energy = work_of(q, 2.0 * q)
    assert work == pytest.approx(0.0, abs=2.0 * step)
    # Half of 2 q^2 a quarter of a period, four periods in all.
    assert energy == pytest.approx(8 * 0.3**2, rel=5.0 * step)
    drag, size = work_of(q, -1.5 * v)
    exact = 1.5 * 0.5 * (0.3 * np.pi) ** 2 * 4.0
    assert drag == pytest.approx(-exact, rel=step)
    assert size == pytest.approx(exact, rel=5.0 * step)


def test_the_effort_of_a_generalised_force_is_its_root_mean_square():
    t = times()[:-1]
    found = used(ForceUse, q=np.zeros((4000, 1)), force=(4.0 + np.sin(np.pi * t))[:, None])
    np.testing.assert_allclose(found["force_effort"], np.sqrt(16.5), rtol=1e-12)

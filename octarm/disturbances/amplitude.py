"""How large the input signal is that a motion needs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from octarm.arm.lagrange import inverse_dynamics
from octarm.arm.parameters import ArmParameters
from octarm.interfaces import Motion

# It is measured on this grid, whatever the physics step.
_WINDOW = 10.0  # [s]
_SAMPLES = 1000
_AT_ONCE = 20_000  # arms times instants


def input_amplitude(arm: ArmParameters, motion: Motion, arms: int = 1) -> np.ndarray:
    """sqrt(2) times the standard deviation over time of the force that a motion needs.

    That is of each generalised force D a_d + (C + B) v_d + G, with which the arm follows the motion
    exactly. Sums of differences from the first value, one instant after another: no cancellation,
    and the same bits for an arm and its row of a batch.

    Args:
        arm: one arm, or with batch axis (n,).
        motion: desired motion of shapes (2N,) or (n, 2N).
        arms: number of arms n.

    Returns:
        Shape (2N,), or (n, 2N) if the arm or the motion has a batch axis [N], [N m].
    """
    forces = _forces(arm, motion, arms)
    first = next(forces)
    total, square = np.zeros_like(first), np.zeros_like(first)
    for force in forces:
        change = force - first
        total += change
        square += change * change
    mean = total / _SAMPLES
    variance = square / _SAMPLES - mean * mean
    return np.sqrt(2.0 * np.maximum(variance, 0.0))


def _forces(arm: ArmParameters, motion: Motion, arms: int) -> Iterator[np.ndarray]:
    """The force at each instant, shape (..., 2N); computed for many instants at once."""
    size = max(1, _AT_ONCE // arms)
    for k in range(0, _SAMPLES, size):
        instants = [motion(i * (_WINDOW / _SAMPLES)) for i in range(k, min(k + size, _SAMPLES))]
        parts = [np.stack(part) for part in zip(*instants, strict=True)]
        if arm.batch_shape:  # after the axis of time
            parts = [part[:, None] if part.ndim == 2 else part for part in parts]
        yield from inverse_dynamics(arm, *parts)

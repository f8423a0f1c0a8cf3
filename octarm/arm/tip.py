"""Where the tip is, for arms side by side."""

from __future__ import annotations

import numpy as np

from octarm.arrays import Entry, split


def tip(q: np.ndarray) -> tuple[Entry, Entry]:
    """The tip p_N of `octarm.lagrange.positions` at q, shape (..., 2N): x and y, shape (...) [m].

    It is elementwise, with one tangent of half the angle, which NumPy computes several times as
    fast as a sine and a cosine.
    """
    n = q.shape[-1] // 2
    entries = split(q)
    x = entries[0]
    y: Entry = 0.0
    phi: Entry = 0.0
    for i, theta in enumerate(entries[n:-1], 1):
        phi = phi + theta
        half = np.tan(0.5 * phi)
        share = 2.0 / (1.0 + half * half)  # 1 + cos phi
        x = x + entries[i] * (share - 1.0)
        y = y + entries[i] * (share * half)
    return x, y

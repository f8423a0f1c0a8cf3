"""The tracking task for Gymnasium: `gymnasium.make("octarm/Track-v0")` once this is imported.

An action is a share of the arm's input range for each column, from -1 to 1. With a controller it is
added to what the controller asks for, as a small share of the range: a residual.

An observation is one row of float32: the coordinates from rest, their velocities, the errors
q - q_d and v - v_d, each 2N numbers. Slides are in tenths of the rest length of their module, bends
in rad. What is beyond the limits of the arm, `octarm.arm.limits`, is cut off.

An episode is terminated when the arm leaves its limits, and truncated when its time is up. Every
reset draws a seed, the `seed` of its info, with which `octarm.load` has the same episode.
`gymnasium.make_vec` steps all arms as a batch; each gets bit for bit what it gets alone.
"""

from __future__ import annotations

import importlib.util

from octarm.errors import ExtraError

if importlib.util.find_spec("gymnasium") is None:
    raise ExtraError("octarm.gym needs the package gymnasium: pip install 'octarm[gym]'")

from gymnasium.envs.registration import register  # pyright: ignore[reportUnknownVariableType]

register(
    "octarm/Track-v0",
    entry_point="octarm.gym.arms:TrackEnv",
    vector_entry_point="octarm.gym.arms:TrackVectorEnv",
)

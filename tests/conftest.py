"""Set-up shared by all tests."""

import os

# Nothing here draws with MuJoCo's renderer; without this, dm_control looks for a display.
os.environ.setdefault("MUJOCO_GL", "disabled")

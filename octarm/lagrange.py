"""The equations of motion of the arm, under their public name; see `octarm.arm.lagrange`."""

from octarm.arm.lagrange import *  # noqa: F403

"""A MuJoCo testbed for robust controllers of a continuum robot arm."""

from octarm.parameters import ArmParameters as ArmParameters

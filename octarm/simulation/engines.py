"""What can step the arm: MuJoCo, the plant of record, or the analytic arm, compiled."""

from __future__ import annotations

import importlib.util

from octarm.errors import OctarmError, closest

MUJOCO, LAGRANGE = "mujoco", "lagrange"
ENGINES = (MUJOCO, LAGRANGE)


def usual_engine() -> str:
    """What searches and other large studies use: `lagrange` where it is installed."""
    return MUJOCO if importlib.util.find_spec("numba") is None else LAGRANGE


def check_engine(name: str) -> None:
    """Raises OctarmError unless it is an engine that is installed."""
    if name not in ENGINES:
        raise OctarmError(f"unknown engine {name!r}{closest(name, ENGINES)}")
    if name == LAGRANGE and usual_engine() != LAGRANGE:
        raise OctarmError("the engine lagrange needs the package numba: pip install 'octarm[fast]'")

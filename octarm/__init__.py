"""A MuJoCo testbed for robust controllers of a continuum robot arm."""

from __future__ import annotations

import importlib
import sys
import types
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from octarm.environment import load as load
    from octarm.interfaces import Command as Command
    from octarm.interfaces import Controller as Controller
    from octarm.interfaces import Measurement as Measurement
    from octarm.interfaces import Reference as Reference
    from octarm.model import build_model as build_model
    from octarm.model import nominal_parameters as nominal_parameters
    from octarm.parameters import ArmParameters as ArmParameters
    from octarm.rollout import rollout as rollout
    from octarm.runs import read_run as read_run
    from octarm.sweep import sweep as sweep
    from octarm.sweeps.folder import read_sweep as read_sweep
    from octarm.sweeps.parser import read_spec as read_spec
    from octarm.trajectory import Trajectory as Trajectory

# Looked up when first used, so that `octarm --help` does not wait for MuJoCo.
_HOMES = {
    "load": "environment",
    "Command": "interfaces",
    "Controller": "interfaces",
    "Measurement": "interfaces",
    "Reference": "interfaces",
    "build_model": "model",
    "nominal_parameters": "model",
    "ArmParameters": "parameters",
    "rollout": "rollout",
    "sweep": "sweep",
    "read_run": "runs",
    "read_sweep": "sweeps.folder",
    "read_spec": "sweeps.parser",
    "Trajectory": "trajectory",
}


class _Package(types.ModuleType):
    """Keeps a function like `octarm.rollout` when Python binds the submodule of that name."""

    def __setattr__(self, name: str, value: Any) -> None:
        if _HOMES.get(name) == name and isinstance(value, types.ModuleType):
            value = getattr(value, name)
        super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module 'octarm' has no attribute {name!r}")
    return getattr(importlib.import_module(f"octarm.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])

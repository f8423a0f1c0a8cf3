"""A MuJoCo testbed for robust controllers of a continuum robot arm."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from octarm.arm.file import read_arm as read_arm
    from octarm.arm.mjcf import build_model as build_model
    from octarm.arm.mjcf import nominal_parameters as nominal_parameters
    from octarm.arm.parameters import ArmParameters as ArmParameters
    from octarm.arm.rod import Rod as Rod
    from octarm.arm.rod import arm_from_rod as arm_from_rod
    from octarm.interfaces import Command as Command
    from octarm.interfaces import Controller as Controller
    from octarm.interfaces import Measurement as Measurement
    from octarm.interfaces import Reference as Reference
    from octarm.recordings.viewing import show as show
    from octarm.reports.report import report as report
    from octarm.runs.folder import Run as Run
    from octarm.runs.folder import read_run as read_run
    from octarm.simulation.environment import load as load
    from octarm.simulation.rollout import rollout as rollout
    from octarm.simulation.trajectory import Trajectory as Trajectory
    from octarm.sweeps.episodes import FinishedSweep as FinishedSweep
    from octarm.sweeps.execute import sweep as sweep
    from octarm.sweeps.spec_file import read_spec as read_spec
    from octarm.sweeps.store import read_sweep as read_sweep

# Looked up when first used, so that `octarm --help` does not wait for MuJoCo.
_NAMES = {
    "arm.file": "read_arm",
    "arm.mjcf": "build_model nominal_parameters",
    "arm.parameters": "ArmParameters",
    "arm.rod": "Rod arm_from_rod",
    "interfaces": "Command Controller Measurement Reference",
    "recordings.viewing": "show",
    "reports.report": "report",
    "runs.folder": "Run read_run",
    "simulation.environment": "load",
    "simulation.rollout": "rollout",
    "simulation.trajectory": "Trajectory",
    "sweeps.episodes": "FinishedSweep",
    "sweeps.execute": "sweep",
    "sweeps.spec_file": "read_spec",
    "sweeps.store": "read_sweep",
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    if name == "lagrange":  # a module, which stays reachable by this name
        return importlib.import_module("octarm.lagrange")
    if name not in _HOMES:
        raise AttributeError(f"module 'octarm' has no attribute {name!r}")
    return getattr(importlib.import_module(f"octarm.{_HOMES[name]}"), name)


def __dir__() -> list[str]:
    return sorted([*globals(), *_HOMES])

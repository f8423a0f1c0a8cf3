"""What a result depends on beside its inputs: versions, and the machine."""

from __future__ import annotations

import contextlib
import functools
import os
import platform
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from octarm.declared import BUILT_IN, Code, distributions
from octarm.simulation.engines import LAGRANGE, MUJOCO

_PACKAGES = ("octarm", "mujoco", "dm-control", "numpy", "rerun-sdk", "scipy", "pyarrow")
_version = functools.cache(version)  # reads a file


def versions(engine: str = MUJOCO, code: Mapping[str, Code] = BUILT_IN) -> dict[str, str]:
    """Of all that a run or a sweep on an engine depends on for being repeated bit for bit.

    That are the packages as well that brought its code.
    """
    packages = (*_PACKAGES, *(("numba",) if engine == LAGRANGE else ()))
    return {
        "python": platform.python_version(),
        "platform": platform.platform(),
        **{name: _version(name) for name in packages},
        **distributions(code),
    }


def host() -> dict[str, Any]:
    """The machine that this process runs on."""
    return {
        "name": platform.node(),
        "machine": platform.machine(),
        "cpu": _cpu(),
        "kernels": _kernels(),
        "cores": os.cpu_count(),
    }


def _cpu() -> str:
    with contextlib.suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor()


def _kernels() -> str:
    """The instruction sets that NumPy selected for its loops: last bits depend on them."""
    try:
        from numpy.lib.introspect import opt_func_info
    except ImportError:  # before NumPy 2.1
        return ""
    functions = opt_func_info(func_name="^(cos|exp|sin|tanh)$", signature="float64")
    names = {loop["current"] for loops in functions.values() for loop in loops.values()}
    return " ".join(sorted(names))

"""What a piece of work takes in memory, against what the machine has, before any is allocated."""

from __future__ import annotations

import resource
from pathlib import Path

import psutil

from octarm.errors import OctarmError

ARM = 4000  # [byte] a module of an arm in a batch: physics, metrics, controller; measured, rounded
_KEPT = 20  # numbers a coordinate and step: q, q_d and inputs, kept, recorded and measured
WORKER = 100e6  # [byte] that a process has of its own before it runs anything


def check_batch(arms: int, modules: int, batches: int = 1, what: str = "batch") -> None:
    """Raises OctarmError for a number of arms in a batch below 1, or more than memory holds.

    There may be several batches, run by as many processes; `what` names the number in the sentence.
    """
    if arms < 1:
        raise OctarmError(f"{what} is {arms}; it must be at least 1")
    each = f"{batches} workers with " if batches > 1 else ""
    needed = batches * (arms * modules * ARM + (WORKER if batches > 1 else 0.0))
    check_memory(needed, f"{each}{arms} arms of {modules} modules side by side")


def check_steps(steps: int, arms: int, modules: int) -> None:
    """Raises OctarmError for more physics steps in a control period than memory holds.

    What happens at each of them is kept until the period is over, for metrics and the record.
    """
    if steps > 1:
        needed = float(steps) * arms * 2 * modules * 8 * _KEPT
        arm = f" of {arms} arms" if arms > 1 else ""
        check_memory(needed, f"{steps} physics steps{arm} in a control period")


def check_memory(needed: float, what: str) -> None:
    """Raises OctarmError where so much [byte] is more than this process may have."""
    free = available()
    if needed > free:
        raise OctarmError(
            f"{what} take about {needed / 1e9:.3g} GB of memory, of which {free / 1e9:.3g} GB are "
            "available"
        )


def available() -> float:
    """The memory that this process may still have [byte], by machine, group and limit."""
    free = float(psutil.virtual_memory().available)
    group = Path("/sys/fs/cgroup")
    try:
        limit, used = ((group / f"memory.{name}").read_text() for name in ("max", "current"))
        free = min(free, float(limit) - float(used))  # `max` where there is no limit
    except (OSError, ValueError):
        pass
    limit = resource.getrlimit(resource.RLIMIT_AS)[0]
    if limit != resource.RLIM_INFINITY:
        free = min(free, float(limit - psutil.Process().memory_info().vms))
    return max(0.0, free)

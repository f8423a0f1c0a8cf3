"""The console command, which says one sentence when it is interrupted, however early.

What is imported stays until the process ends: to look through it for objects that could be freed,
as Python does again and again while it imports and once more at its end, would take a quarter of
the time in which a command starts.
"""

from __future__ import annotations

import gc
import sys
from pathlib import Path

from octarm.interrupts import end_at_once, raise_interrupts


def command_line() -> int:
    """Runs the words that the process was started with; returns the exit code."""
    end_at_once()  # the imports take a moment
    gc.disable()
    from octarm.commands.cli import main
    from octarm.commands.terminal import repair_streams

    repair_streams()
    code = main(begin=_begin)
    gc.freeze()
    return code


def _begin() -> None:
    """All is imported, and the work begins."""
    gc.freeze()
    gc.enable()
    raise_interrupts()


if __name__ == "__main__":
    # The working folder, which may hold a package `controllers` of its own, is searched last.
    if not sys.flags.safe_path and Path(sys.path[0]) != Path(__file__).resolve().parents[1]:
        sys.path.append(sys.path.pop(0))
    sys.exit(command_line())

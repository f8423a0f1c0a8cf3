"""The console command, which says one sentence when it is interrupted, however early."""

from __future__ import annotations

import sys
from pathlib import Path

from octarm.interrupts import end_at_once, raise_interrupts


def command_line() -> int:
    """Runs the words that the process was started with; returns the exit code."""
    end_at_once()  # the imports take a moment
    from octarm.commands.cli import main
    from octarm.commands.terminal import repair_streams

    repair_streams()
    return main(begin=raise_interrupts)


if __name__ == "__main__":
    # The working folder, which may hold a package `controllers` of its own, is searched last.
    if not sys.flags.safe_path and Path(sys.path[0]) != Path(__file__).resolve().parents[1]:
        sys.path.append(sys.path.pop(0))
    sys.exit(command_line())

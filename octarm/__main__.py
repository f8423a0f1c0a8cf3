"""The console command, which says one sentence when it is interrupted, however early."""

from __future__ import annotations

import sys

from octarm.interrupts import end_at_once, raise_interrupts


def command_line() -> int:
    """Runs the words that the process was started with; returns the exit code."""
    end_at_once()  # the imports take a moment
    from octarm.commands.cli import main
    from octarm.commands.terminal import repair_streams

    repair_streams()
    return main(begin=raise_interrupts)


if __name__ == "__main__":
    sys.exit(command_line())

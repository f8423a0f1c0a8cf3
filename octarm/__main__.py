"""The console command, which says one sentence when it is interrupted, however early.

Importing takes a moment, in which there is nothing to clean up yet: the process ends at once.
"""

from __future__ import annotations

import os
import signal
import sys
from typing import Any

_INTERRUPTED = 130  # ExitCode.INTERRUPTED, whose module would be the first import


def command_line() -> int:
    """Runs the words that the process was started with; returns the exit code."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _leave)
    from octarm.commands import cli

    return cli.command_line()


def _leave(*_: Any) -> None:
    os.write(2, b"octarm: interrupted\n")
    os._exit(_INTERRUPTED)


if __name__ == "__main__":
    sys.exit(command_line())

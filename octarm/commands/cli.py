"""The command line: from words to the options of a command, and from errors to one sentence.

What each command can be asked for stands in `octarm.options`, what it does in `octarm.commands`;
the latter's heavy modules are imported once it is known which command it is.
"""

from __future__ import annotations

import functools
import math
import os
import signal
import sys
import time
from collections.abc import Callable, Sequence

from octarm.errors import ExitCode
from octarm.options.checks import Validate, Verify
from octarm.options.machine import Completion, Doctor
from octarm.options.parser import parse
from octarm.options.recordings import Plot, Record, Replay, Video
from octarm.options.run import Run
from octarm.options.sweeps import Margin, Report, Sweep
from octarm.options.table import Command
from octarm.options.tune import Tune

_MOMENT = 3.0  # [s]


def main(arguments: Sequence[str] | None = None, *, begin: Callable[[], None] | None = None) -> int:
    """Runs a command line; returns the exit code.

    Args:
        arguments: the words after `octarm`; those of this process when not given.
        begin: called when all is understood and imported, before the work.
    """
    try:
        work = _work(parse(sys.argv[1:] if arguments is None else arguments))
        if begin is not None:
            begin()
        code = work()
        sys.stdout.flush()
        return code
    except BrokenPipeError:  # whoever read the output has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return ExitCode.FINE
    except MemoryError as error:
        print(f"octarm: there is not enough memory: {_one_line(error)}", file=sys.stderr)
        return ExitCode.BAD_INPUT
    except ImportError as error:
        print(f"octarm: {error}; octarm doctor says what to install", file=sys.stderr)
        return ExitCode.BAD_INPUT
    except (ValueError, OSError, RuntimeError) as error:
        print(f"octarm: {_one_line(error)}", file=sys.stderr)
        return ExitCode.BAD_INPUT
    except KeyboardInterrupt as error:
        print("; ".join(["octarm: interrupted", *error.args]), file=sys.stderr)
        return ExitCode.INTERRUPTED


def command_line() -> int:
    """The console command: `main`, which Ctrl-C and SIGTERM interrupt."""
    return main(begin=_let_interrupt)


def _let_interrupt() -> None:
    """Lets SIGTERM do what Ctrl-C does.

    A second one within a moment changes nothing: a run that was interrupted is being closed.
    """
    before = -math.inf

    def interrupt(*_: object) -> None:
        nonlocal before
        now = time.monotonic()
        if now - before > _MOMENT:
            before = now
            raise KeyboardInterrupt

    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, interrupt)


def _work(options: Command) -> Callable[[], int]:
    """What is to be done, with the modules that it needs imported."""
    match options:
        case Run():
            from octarm.commands.run import run

            return functools.partial(run, options)
        case Validate():
            from octarm.commands.run import validate

            return functools.partial(validate, options)
        case Sweep():
            from octarm.commands.sweep import sweep

            return functools.partial(sweep, options)
        case Report():
            from octarm.commands.report import report

            return functools.partial(report, options)
        case Verify():
            from octarm.commands.verify import verify

            return functools.partial(verify, options)
        case Margin():
            from octarm.commands.margin import margin

            return functools.partial(margin, options)
        case Tune():
            from octarm.commands.tune import tune

            return functools.partial(tune, options)
        case Replay():
            from octarm.commands.replay import replay

            return functools.partial(replay, options)
        case Record():
            from octarm.commands.replay import record

            return functools.partial(record, options)
        case Plot():
            from octarm.commands.replay import plot

            return functools.partial(plot, options)
        case Doctor():
            from octarm.commands.doctor import doctor

            return doctor
        case Completion():
            from octarm.options.completion import completion

            return functools.partial(completion, options)
        case Video():
            from octarm.recordings.video import choose_renderer

            choose_renderer()  # before anything imports MuJoCo
            from octarm.commands.replay import video

            return functools.partial(video, options)


def _one_line(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return f"{error.filename or 'standard output'}: {error.strerror}"
    return " ".join(str(error).split())


if __name__ == "__main__":
    sys.exit(command_line())

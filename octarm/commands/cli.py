"""The command line: runs a command, and says errors in one sentence."""

from __future__ import annotations

import errno
import importlib.machinery
import sys
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path

from octarm.commands.terminal import check_open_files, silence, surviving_errors
from octarm.errors import ExitCode, FileError, OctarmError, printable, sentence_of

# How MuJoCo, the system's loader, Python's threads and rerun say it, each by errors of its own.
_NO_MEMORY = (
    "ould not allocate memory",
    "annot allocate memory",
    "failed to map segment",
    "can't start new thread",
    "failed to spawn background thread",
)


def main(arguments: Sequence[str] | None = None, *, begin: Callable[[], None] | None = None) -> int:
    """Runs the words after `octarm`, those of this process if not given; returns the exit code.

    `begin` is called when all is understood and imported, before the work. An exception that a user
    cannot mend is a bug, and passes.
    """
    with surviving_errors(), warnings.catch_warnings(action="ignore"):  # of numbers, mostly
        try:
            check_open_files()
            _check_controllers()
            from octarm.commands.app import parse

            work = parse(sys.argv[1:] if arguments is None else arguments)
            if begin is not None:
                begin()
            code = work()
            sys.stdout.flush()
            return code
        except BrokenPipeError:  # whoever read the output has seen enough
            silence(sys.stdout)
            return ExitCode.FINE
        except KeyboardInterrupt as error:
            print(printable("; ".join(["octarm: interrupted", *error.args])), file=sys.stderr)
            return ExitCode.INTERRUPTED
        except Exception as error:
            mendable = _mendable(error)
            print(f"octarm: {' '.join(str(mendable).split())}", file=sys.stderr)
            try:
                sys.stdout.flush()
            except OSError:
                silence(sys.stdout)  # it would fail once more at the very end
            return mendable.exit_code


def _check_controllers() -> None:
    """Raises OctarmError if another `controllers` than that beside octarm would be imported."""
    spec = importlib.machinery.PathFinder.find_spec("controllers")
    file = Path((spec.origin if spec else "") or "")
    right = Path(__file__).resolve().parents[2] / "controllers" / "__init__.py"
    if "controllers" not in sys.modules and file.name and file.resolve() != right:
        place = file.parent if file.name == right.name else file
        raise OctarmError(
            f"{place} would be imported in place of octarm's own package controllers; give it "
            "another name, or keep its folder out of PYTHONPATH"
        )


def _mendable(error: Exception) -> OctarmError:
    """What a user can mend, or what the machine refuses; raises the error itself if it is a bug."""
    match error:
        case _ if isinstance(error, MemoryError) or any(w in str(error) for w in _NO_MEMORY):
            return OctarmError(f"there is not enough memory{f': {error}' if str(error) else ''}")
        case OctarmError():
            return error
        case OSError(errno=errno.EMFILE):
            return OctarmError("too many files are open; ulimit -n allows more")
        case OSError() if error.strerror:
            return FileError(sentence_of(error))
        case ModuleNotFoundError():
            return OctarmError(f"{error}; octarm doctor says what to install")
        case _:
            raise error

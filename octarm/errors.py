"""How errors are said, and the exit codes of the commands."""

from __future__ import annotations

import difflib
import enum
from collections.abc import Iterable


class ExitCode(enum.IntEnum):
    """What a command's exit code means."""

    FINE = 0
    CHECK_FAILED = 1
    BAD_INPUT = 2
    DIVERGED = 3
    INTERRUPTED = 130


class OctarmError(ValueError):
    """What a user can mend: one sentence with the value, what is allowed and the closest match.

    The command line prints it and exits with 2. Any other exception is a bug in the program.
    """


class FileError(OctarmError, OSError):
    """A file or folder that cannot be read or written; the sentence names it."""


def sentence_of(error: OSError) -> str:
    """What the system says of a file, or the sentence that the error has already."""
    if not error.strerror:
        return str(error)
    return f"{error.filename or 'standard output'}: {error.strerror}"


def closest(word: str, known: Iterable[str]) -> str:
    """The end of an error sentence: what a misspelt word may have meant, and all known ones."""
    known = list(known)
    match = difflib.get_close_matches(word, known, n=1)
    meant = f", did you mean {match[0]!r}?" if match else ";"
    return f"{meant} known are {', '.join(known)}"

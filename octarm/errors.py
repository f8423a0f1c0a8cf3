"""How errors are said, how values stand in sentences, and the exit codes of the commands."""

from __future__ import annotations

import difflib
import enum
from collections.abc import Callable, Iterable
from typing import Any, ClassVar

_LONGEST_VALUE = 80  # characters of a value in a sentence
_LONGEST_WORD = 256  # of a sentence: a file's name, or a key
_LONGEST_SENTENCE = 2000
_MOST_NAMES, _NEAREST = 12, 6  # known words that are named, and those of a longer list
_LONGEST_GUESS = 200  # of a word for which the closest known one is looked for


class ExitCode(enum.IntEnum):
    """What a command's exit code means."""

    FINE = 0
    CHECK_FAILED = 1
    BAD_INPUT = 2
    DIVERGED = 3
    INTERRUPTED = 130


class OctarmError(ValueError):
    """What a user can mend: one sentence with the value, what is allowed and the closest match.

    The command line prints it and exits with 2. Any other exception is a bug in the program. Names
    of files and keys may stand in it as they are: the whole is made printable and not too long.
    """

    exit_code: ClassVar[ExitCode] = ExitCode.BAD_INPUT

    def __str__(self) -> str:
        """The sentence, printable and of limited length."""
        words = " ".join(map(str, self.args)).split(" ")
        return printable(" ".join(_shortened(w, _LONGEST_WORD) for w in words), _LONGEST_SENTENCE)


class TooSlow(OctarmError):
    """What got nowhere for too long, as on a machine that is too busy; nothing wrong was asked."""

    exit_code = ExitCode.CHECK_FAILED


class FileError(OctarmError, OSError):
    """A file or folder that cannot be read or written; the sentence names it."""


class ExtraError(OctarmError, ImportError):
    """A package that is not installed; the sentence names the extra that brings it."""


def printable(text: str, longest: int | None = None) -> str:
    r"""The text in characters that a terminal, a page or a plot shows as they are.

    Control characters, marks of the direction of writing, line breaks and halves of surrogate pairs
    become their escapes, such as `\x1b`. Of more than `longest` characters the middle is left out.
    """
    if longest is not None:
        text = _shortened(text, longest)
    if text.isprintable():
        return text
    text = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
    return text if longest is None else _shortened(text, longest)


def quoted(value: object, spell: Callable[[Any], str] = repr) -> str:
    """A value as it stands in a sentence: printable, of limited length, as Python spells it.

    Another `spell` may be that of a file.
    """
    try:
        text = spell(_shortened(value, _LONGEST_VALUE) if isinstance(value, str) else value)
    except (RecursionError, ValueError):  # Python spells no number of more than 4300 digits
        text = f"a {type(value).__name__} that is too long to be spelt"
    if not isinstance(value, str):  # an array is spelt on several lines
        text = " ".join(text.split())
    return printable(text, _LONGEST_VALUE)


def _shortened(text: str, longest: int) -> str:
    """The text without its middle if it is longer."""
    if len(text) <= longest:
        return text
    end = longest // 3
    return f"{text[: longest - end - 3]}...{text[-end:]}"


def sentence_of(error: OSError) -> str:
    """What the system says of a file, or the sentence that the error has already."""
    if not error.strerror:
        return str(error)
    return f"{error.filename or 'standard output'}: {error.strerror}"


def similar(word: str, known: Iterable[str]) -> str:
    """The end of an error sentence: the most similar of many known words, if there is one."""
    match = difflib.get_close_matches(word, [*known], n=1)
    return f", did you mean {quoted(match[0])}?" if match else ""


def closest(word: object, known: Iterable[str], meant: str = "") -> str:
    """The end of an error sentence: what a misspelt word may have meant, and the known ones.

    Of more than a dozen only the nearest are named. What is `meant` is the most similar known word
    unless it is given.
    """
    text = str(word)[:_LONGEST_GUESS].casefold()
    known = {name.casefold(): name for name in known}
    nearest = [known[n] for n in difflib.get_close_matches(text, known, _NEAREST, 0.0)]
    if not meant and (match := difflib.get_close_matches(text, known, n=1)):
        meant = quoted(known[match[0]])
    meant = f", did you mean {meant}?" if meant else ";"
    if len(known) <= _MOST_NAMES:
        return f"{meant} known are {', '.join(known.values())}"
    return f"{meant} the nearest of {len(known)} are {', '.join(nearest)}"

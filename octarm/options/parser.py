"""From words to the options of a command, and the help pages."""

from __future__ import annotations

import argparse
import dataclasses
import functools
import inspect
import re
import textwrap
import types
from collections.abc import Sequence
from typing import Any, NoReturn, get_args, get_origin, get_type_hints

from octarm.errors import OctarmError, closest
from octarm.options.argument import Operand, Option
from octarm.options.table import COMMANDS, GROUPS, Command
from octarm.options.words import known_words

_WIDTH = 80  # of the help pages, also where they are piped
_LISTED = ("CONTROLLER", "REFERENCE", "SHELL")  # kinds of value whose words the help lists
_OVERVIEW = """\
usage: octarm COMMAND [OPTIONS]

A testbed for robust controllers of a continuum robot arm.
{groups}

options:
  -h, --help  show this page, or that of a COMMAND, with examples
  --version   show the version

exit codes:
  0 fine, 1 a check failed, 2 bad input, 3 the run diverged, 130 interrupted

To begin with: octarm run --view
"""


@dataclasses.dataclass(frozen=True)
class Argument:
    """A field of a command's description.

    Attributes:
        name: of the field.
        mark: how it is written.
        kind: type of one value.
        several: whether it holds a tuple of them.
        default: `dataclasses.MISSING` when it has none.
    """

    name: str
    mark: Option | Operand
    kind: type
    several: bool
    default: Any

    @property
    def flag(self) -> str:
        """Its spelling, `--control-period`; RUN for an operand."""
        if isinstance(self.mark, Operand):
            return self.mark.value
        return "--" + self.name.replace("_", "-")

    @property
    def help(self) -> str:
        """What is said of it, with its words and its default."""
        words = known_words(self.mark.value) if self.mark.value in _LISTED else []
        parts = [self.mark.text + (f": {', '.join(words)}" if words else "")]
        if self.several and isinstance(self.mark, Option):
            parts.append("(repeatable)")
        elif self.kind is not bool and self.default not in (None, dataclasses.MISSING):
            shown = f"{self.default:g}" if self.kind is float else self.default
            parts.append(f"(default: {shown})")
        return " ".join(parts).replace("%", "%%")


@functools.cache
def arguments_of(kind: type[Command]) -> list[Argument]:
    """The fields of a command's description, in their order."""
    hints = get_type_hints(kind, include_extras=True)
    return [_argument(field, hints[field.name]) for field in dataclasses.fields(kind)]


def _argument(field: dataclasses.Field[Any], hint: Any) -> Argument:
    hint, mark = get_args(hint)
    if get_origin(hint) is types.UnionType:  # X | None
        hint = get_args(hint)[0]
    several = get_origin(hint) is tuple
    kind = get_args(hint)[0] if several else hint
    return Argument(field.name, mark, kind, several, field.default)


def parse(words: Sequence[str]) -> Command:
    """What a command line asks for.

    Raises:
        ValueError: for a word that is not understood, in one sentence.
        SystemExit: when a help page or the version was asked for, and printed.
    """
    if not words:
        raise OctarmError("no command is given; octarm --help lists them")
    name, *others = words
    if name in ("-h", "--help", "--version"):
        print(overview() if name != "--version" else _version(), end="")
        raise SystemExit(0)
    if name not in COMMANDS:
        raise OctarmError(f"unknown command {name!r}{closest(name, COMMANDS)}")
    kind = COMMANDS[name]
    arguments = arguments_of(kind)
    found, unknown = _parser(name).parse_known_intermixed_args(_joined(others, arguments))
    if unknown:
        raise OctarmError(_no_such(name, unknown))
    given = {a.name: _value(name, a, getattr(found, a.name)) for a in arguments}
    return kind(**given)


def overview() -> str:
    """The page of `octarm --help`."""
    lines: list[str] = []
    for title, kinds in GROUPS.items():
        lines += ["", f"{title}:"]
        lines += [f"  {kind.__name__.lower():<11} {summary(kind)}" for kind in kinds]
    return _OVERVIEW.format(groups="\n".join(lines))


def summary(kind: type[Command]) -> str:
    """The first line that is said of a command."""
    return inspect.getdoc(kind).partition("\n")[0]  # pyright: ignore[reportOptionalMemberAccess]


class _Page(argparse.RawDescriptionHelpFormatter):
    """Breaks lines at spaces only: `afsmc-consequent` is one word."""

    def _split_lines(self, text: str, width: int) -> list[str]:
        whole = text.replace("(default: ", "(default:\xa0")
        lines = textwrap.wrap(whole, width, break_on_hyphens=False)
        return [line.replace("\xa0", " ") for line in lines]


class _Parser(argparse.ArgumentParser):
    """Splits words; says what is wrong by an exception."""

    def error(self, message: str) -> NoReturn:
        """Raises ValueError."""
        message = message.removeprefix("argument ")
        raise OctarmError(re.sub(r": expected one argument$", " needs a value after it", message))


def _parser(name: str) -> _Parser:
    """Splits the words after a command; all values stay words, in lists."""
    kind = COMMANDS[name]
    arguments = arguments_of(kind)
    before, after = _described(kind)
    operands = "".join(f" {_usage(a)}" for a in arguments if isinstance(a.mark, Operand))
    parser = _Parser(
        prog=f"octarm {name}",
        usage=f"octarm {name}{operands} [OPTIONS]",
        description=before,
        epilog=after,
        formatter_class=lambda prog: _Page(prog, max_help_position=24, width=_WIDTH),
        add_help=False,
        allow_abbrev=False,
    )
    sections: dict[str, Any] = {"operands": parser.add_argument_group("operands")}
    for a in arguments:
        if isinstance(a.mark, Operand):
            sections["operands"].add_argument(
                a.name, metavar=a.flag, nargs="*", default=[], help=a.help
            )
            continue
        if a.mark.section not in sections:
            sections[a.mark.section] = parser.add_argument_group(a.mark.section)
        how: dict[str, Any] = {"action": "append", "metavar": a.mark.value}
        if a.kind is bool:
            how = {"action": "store_true"}
        sections[a.mark.section].add_argument(a.flag, dest=a.name, help=a.help, **how)
    parser.add_argument("-h", "--help", action="help", help=argparse.SUPPRESS)
    return parser


def _usage(operand: Argument) -> str:
    return f"{operand.mark.value} [{operand.mark.value} ..]" if operand.several else operand.flag


def _described(kind: type[Command]) -> tuple[str, str]:
    """What is said of a command before its options, and from its examples on."""
    before, heading, after = inspect.getdoc(kind).partition("Examples:\n")  # pyright: ignore
    paragraphs = [
        textwrap.fill(" ".join(p.split()), _WIDTH, break_on_hyphens=False)
        for p in before.strip().split("\n\n")
    ]
    return "\n\n".join(paragraphs), "examples:\n" + after if heading else ""


def _joined(words: Sequence[str], arguments: Sequence[Argument]) -> list[str]:
    """Joins an option and a value that begins with a minus sign, such as --low -1e-3."""
    takers = {a.flag for a in arguments if isinstance(a.mark, Option) and a.kind is not bool}
    flags = {a.flag for a in arguments} | {"-h", "--help"}
    joined: list[str] = []
    waiting = False
    for word in words:
        if waiting and word.startswith("-") and word not in flags and not word.startswith("--"):
            joined[-1] = f"{joined[-1]}={word}"
            waiting = False
        else:
            joined.append(word)
            waiting = not waiting and word in takers
    return joined


def _value(command: str, argument: Argument, words: list[str] | bool | None) -> Any:
    """The value of a field.

    Raises:
        ValueError: if the words do not make one.
    """
    if isinstance(words, bool):
        return words
    if not words:
        if argument.default is not dataclasses.MISSING:
            return argument.default
        if argument.several:
            return ()
        raise OctarmError(f"octarm {command} needs {argument.flag}, {argument.mark.text}")
    if argument.several:
        return tuple(_one(argument, word) for word in words)
    if len(words) > 1:
        again = f"{argument.flag} is given twice: {words[0]!r} and {words[1]!r}"
        raise OctarmError(again)
    return _one(argument, words[0])


def _one(argument: Argument, word: str) -> Any:
    kind, flag = argument.kind, argument.flag
    try:
        return kind(word)
    except ValueError:
        needed = "a whole number" if kind is int else "a number"
        raise OctarmError(f"{flag} is {word!r}; it must be {needed}") from None


def _no_such(command: str, unknown: Sequence[str]) -> str:
    """The sentence on the first option that a command does not have."""
    word = next((w for w in unknown if w.startswith("-")), unknown[0]).partition("=")[0]
    own = [a.flag for a in arguments_of(COMMANDS[command]) if isinstance(a.mark, Option)]
    owners = [n for n, k in COMMANDS.items() if word in [a.flag for a in arguments_of(k)]]
    if not word.startswith("-"):
        return f"octarm {command} has no use for {word!r}"
    if owners:
        return f"octarm {command} has no option {word}; it belongs to octarm {', '.join(owners)}"
    return f"octarm {command} has no option {word!r}{closest(word, own)}"


def _version() -> str:
    from importlib.metadata import version

    return f"octarm {version('octarm')}\n"

"""The help pages, from the declarations of the commands."""

from __future__ import annotations

import inspect
import pkgutil
import textwrap
from typing import Any, get_origin

from cyclopts import App, Argument, Parameter

from octarm.commands.kinds import known_words

_WIDTH = 80  # also where a page is piped
_COLUMN = 24  # where the text on an option begins
_LISTED = ("CONTROLLER", "REFERENCE", "SHELL", "KIND")  # whose words stand in the text
# Where the texts are made that stand below the examples.
_TEXTS = {
    "{references}": "octarm.references.catalogue:help_text",
    "{disturbances}": "octarm.disturbances.spelling:help_text",
}
_OVERVIEW = """\
usage: octarm COMMAND [OPTIONS]

A testbed for robust controllers of a continuum robot arm.

{commands}

options:
  -h, --help  show this page, or that of a COMMAND, with examples
  --version   show the version

exit codes:
  0 fine, 1 a check failed, 2 bad input, 3 the run diverged, 130 interrupted

To begin with: octarm run --view"""


def overview(app: App) -> str:
    """The page of `octarm --help`: all commands by group."""
    groups: dict[str, list[str]] = {}
    for name in commands(app):
        command = app[name]
        summary = command.help.partition("\n")[0]
        for title in _titles(command):
            groups.setdefault(title, []).append(f"  {name:<11} {summary}")
    blocks = ["\n".join([f"{title}:", *lines]) for title, lines in groups.items()]
    return _OVERVIEW.format(commands="\n\n".join(blocks))


def page(app: App, name: str) -> str:
    """The page of `octarm NAME --help`.

    The docstring of the command has the text, the arguments and the examples, in this order.
    """
    text, _, examples = inspect.cleandoc(app[name].help).partition("\nExamples:\n")
    paragraphs = text.partition("\nArgs:\n")[0].strip().split("\n\n")
    arguments = arguments_of(app, name)
    operands = [a for a in arguments if is_operand(a)]
    usage = "".join(f" {spelling(a)}" + f" [{spelling(a)} ..]" * is_repeatable(a) for a in operands)
    lines = [f"usage: octarm {name}{usage} [OPTIONS]"]
    for paragraph in paragraphs:
        words = " ".join(paragraph.split())
        lines += ["", textwrap.fill(words, _WIDTH, break_on_hyphens=False)]
    for title in dict.fromkeys(title for a in arguments for title in _titles(a.parameter)):
        lines += ["", f"{title}:"]
        lines += [_entry(a) for a in arguments if title in _titles(a.parameter)]
    for mark, place in _TEXTS.items():
        if mark in examples:
            examples = examples.replace(mark, pkgutil.resolve_name(place)() or "  none")
    return "\n".join([*lines, "", "examples:", examples.rstrip()])


def _titles(grouped: App | Parameter) -> list[str]:
    """The headings under which a command or an argument stands."""
    groups: Any = grouped.group
    return [group.name for group in groups]


def commands(app: App) -> list[str]:
    """The names of all commands, in order."""
    return [name for name in app if not name.startswith("-")]


def arguments_of(app: App, name: str) -> list[Argument]:
    """The options and operands of a command, with their help."""
    collection = app[name].assemble_argument_collection(parse_docstring=True)
    return [a for a in collection if a.name != "*"]  # a table of options is none itself


def is_operand(argument: Argument) -> bool:
    """Whether an argument is given by its place."""
    return argument.index is not None


def is_repeatable(argument: Argument) -> bool:
    """Whether an argument may be given several times."""
    return get_origin(argument.hint) is tuple


def spelling(argument: Argument) -> str:
    """How an argument stands on a page: `--control-period`, or RUN for an operand."""
    return str(argument.parameter.metavar) if is_operand(argument) else argument.name


def _entry(argument: Argument) -> str:
    """The lines on an argument: its spelling, what it is for, its words and its default."""
    value = argument.parameter.metavar or ""
    parts = [argument.parameter.help or ""]
    if value in _LISTED:
        own = ", FILE.py:NAME, MODULE:NAME" if value in ("CONTROLLER", "REFERENCE") else ""
        parts[0] += f": {', '.join(known_words(value))}{own}"
    default: Any = argument.field_info.default
    if is_repeatable(argument) and not is_operand(argument):
        parts.append("(repeatable)")
    elif isinstance(default, int | float | str) and not isinstance(default, bool):
        shown = default if isinstance(default, str) else f"{default:g}"
        parts.append(f"(default:\xa0{shown})")
    lines = textwrap.wrap(" ".join(parts), _WIDTH - _COLUMN, break_on_hyphens=False)
    text = textwrap.indent("\n".join(lines), " " * _COLUMN).replace("\xa0", " ")
    head = "  " + (value if is_operand(argument) else f"{argument.name} {value}".rstrip())
    return f"{head}\n{text}" if len(head) > _COLUMN - 2 else head.ljust(_COLUMN) + text.lstrip()

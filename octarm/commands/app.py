"""All commands, their help pages, and what a command line asks of them."""

from __future__ import annotations

import functools
import importlib.metadata
import inspect
import os
import pkgutil
import re
import resource
import textwrap
from collections.abc import Callable, Sequence
from typing import Annotated, Any, get_origin

from cyclopts import App, Argument, CycloptsError, Group, Parameter, exceptions

from octarm.commands import checks, kinds, many_runs, one_run, recorded, yours
from octarm.commands.kinds import SHELLS, Work, known_words
from octarm.errors import ExitCode, FileError, OctarmError, closest, printable, quoted

APP = App(
    name="octarm",
    version=lambda: f"octarm {importlib.metadata.version('octarm')}",
    group_arguments=Group("operands"),
    group_parameters=Group("options"),
    default_parameter=Parameter(negative=(), json_list=False, json_dict=False),
)


def completion(shell: Annotated[str, kinds.SHELL], /) -> Work:
    """Print a script by which a shell completes commands.

    Commands, options, names of controllers and references, files and folders.

    Args:
        shell: the shell

    Examples:
      octarm completion bash >> ~/.bashrc
      octarm completion zsh >> ~/.zshrc
      octarm completion fish > ~/.config/fish/completions/octarm.fish
    """
    if shell not in SHELLS:
        raise OctarmError(f"unknown shell {quoted(shell)}{closest(shell, SHELLS)}")
    script = APP.generate_completion(shell=shell)
    return functools.partial(print, script + _AFTER.get(shell, ""))


for title, functions in {
    "one run": (
        *(one_run.run, one_run.view, recorded.replay, recorded.record),
        *(recorded.plot, recorded.video, recorded.compare),
    ),
    "many runs": (many_runs.sweep, many_runs.report, many_runs.margin, many_runs.tune),
    "an arm": (yours.arm,),
    "your own": (yours.new,),
    "checks": (checks.validate, checks.verify),
    "this machine": (checks.doctor, completion),
}.items():
    group = Group(title)
    for function in functions:
        APP.command(function, group=group)

# [GB] that rerun reserves, although it uses little of them; other commands need less.
_ADDRESS_SPACE = {"run": 3.5, "record": 3.5, "replay": 3.5, "compare": 3.5}

# What makes the script work at the end of ~/.zshrc; the function is named by cyclopts.
_AFTER = {"zsh": "autoload -U +X compinit && compinit\ncompdef _cyclopts_octarm octarm"}

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


def parse(words: Sequence[str]) -> Callable[[], int]:
    """What a command line asks for, with the modules that it needs imported; gives the exit code.

    Names and files that there are not are refused by the work, and nothing more is imported then.
    Raises OctarmError for a word that is not understood.
    """
    if not words:
        raise OctarmError("no command is given; octarm --help lists them")
    if any("\0" in word for word in words):  # no process gets such words, but a caller may
        raise OctarmError("a word holds a zero byte, which no name and no value has")
    try:
        command, bound, _ = APP.parse_args(_joined(words), print_error=False, exit_on_error=False)
    except CycloptsError as error:
        sentence = OctarmError(_sentence(error, words[0]))
        if isinstance(error.__cause__, FileError):
            return functools.partial(_refuse, sentence)
        raise sentence from None
    if command == APP.help_print:
        name = next(iter(bound.arguments["tokens"]), None)
        work: Work = functools.partial(print, overview() if name is None else page(name))
    elif command.__module__.startswith("octarm."):
        _check_address_space(words[0])
        try:
            work = command(*bound.args, **bound.kwargs)
        except OctarmError as error:
            work = functools.partial(_refuse, error)
    else:  # the version, words for a shell
        work = functools.partial(command, *bound.args, **bound.kwargs)
    return lambda: work() or ExitCode.FINE


def _joined(words: Sequence[str]) -> list[str]:
    """The words, a negative number, which may be -30%, joined to the option before it."""
    joined: list[str] = []
    for word in words:
        if re.match(r"-\.?\d", word) and joined and re.fullmatch("--[^=]+", joined[-1]):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def _check_address_space(command: str) -> None:
    """Raises OctarmError if the libraries that a command loads would abort for lack of memory."""
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    needed = _ADDRESS_SPACE.get(command, 1.5) + 0.11 * (os.cpu_count() or 1)  # threads have stacks
    if limit != resource.RLIM_INFINITY and limit < 1e9 * needed:
        raise OctarmError(
            f"the memory of this process is limited to {1e-9 * limit:.3g} GB of addresses (ulimit "
            f"-v); octarm {command} needs {needed:.3g} GB on this machine"
        )


def _refuse(error: OctarmError) -> int:
    raise error


def _sentence(error: CycloptsError, command: str) -> str:
    """What is wrong with a command line, as a sentence."""
    match error:
        case exceptions.UnknownCommandError():
            return f"unknown command {quoted(command)}{closest(command, commands())}"
        case exceptions.UnknownOptionError():
            return _no_such_option(command, (error.token.keyword or error.token.value))
        case exceptions.UnusedCliTokensError(unused_tokens=[word, *_]):
            return f"octarm {command} has no use for {quoted(word)}{_as_option(command, word)}"
        case exceptions.RepeatArgumentError():
            return f"{error.token.keyword} is given twice"
        case exceptions.ConsumeMultipleError(argument=Argument() as argument):
            return f"{argument.name} takes one value at most"
        case exceptions.MissingArgumentError(argument=Argument() as argument):
            if not is_operand(argument):
                return f"{argument.name} needs a value after it"
            known = {spelling(a): a.parameter.help for a in arguments_of(command)}
            return f"octarm {command} needs {spelling(argument)}, {known[spelling(argument)]}"
        case exceptions.CoercionError(msg=str() as sentence):
            return sentence
        case exceptions.CoercionError(token=token) if token is not None:
            return f"{token.keyword} is {quoted(token.value)}; it is a flag and takes no value"
        case _:
            return " ".join(str(error).split())


def _as_option(command: str, word: str) -> str:
    """What a word may have meant that lacks the dashes of an option."""
    name, equals, value = word.lstrip("-").partition("=")
    option = f"--{name.replace('_', '-')}"
    if option not in map(spelling, arguments_of(command)):
        return ""
    return f", did you mean {printable(option + equals + value, 80)}?"


def _no_such_option(command: str, word: str) -> str:
    owners = [n for n in commands() if word in map(spelling, arguments_of(n))]
    if owners:
        return f"octarm {command} has no option {word}; it belongs to octarm {', '.join(owners)}"
    known = [spelling(a) for a in arguments_of(command) if not is_operand(a)]
    return f"octarm {command} has no option {quoted(word)}{closest(word, known)}"


def overview() -> str:
    """The page of `octarm --help`: all commands by group."""
    groups: dict[str, list[str]] = {}
    for name in commands():
        command = APP[name]
        summary = command.help.partition("\n")[0]
        for title in _titles(command):
            groups.setdefault(title, []).append(f"  {name:<11} {summary}")
    blocks = ["\n".join([f"{title}:", *lines]) for title, lines in groups.items()]
    return _OVERVIEW.format(commands="\n\n".join(blocks))


def page(name: str) -> str:
    """The page of `octarm NAME --help`.

    The docstring of the command has the text, the arguments and the examples, in this order.
    """
    text, _, examples = inspect.cleandoc(APP[name].help).partition("\nExamples:\n")
    paragraphs = text.partition("\nArgs:\n")[0].strip().split("\n\n")
    arguments = arguments_of(name)
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


def commands() -> list[str]:
    """The names of all commands, in order."""
    return [name for name in APP if not name.startswith("-")]


def arguments_of(name: str) -> list[Argument]:
    """The options and operands of a command, with their help."""
    collection = APP[name].assemble_argument_collection(parse_docstring=True)
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

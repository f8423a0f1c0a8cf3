"""All commands, and what a command line asks of them."""

from __future__ import annotations

import functools
import importlib.metadata
import os
import re
import resource
from collections.abc import Callable, Sequence
from typing import Annotated

from cyclopts import App, Argument, Group, Parameter
from cyclopts.exceptions import (
    CoercionError,
    ConsumeMultipleError,
    CycloptsError,
    MissingArgumentError,
    RepeatArgumentError,
    UnknownCommandError,
    UnknownOptionError,
    UnusedCliTokensError,
)

from octarm.commands import checks, kinds, many_runs, one_run, recorded, yours
from octarm.commands.kinds import Work
from octarm.commands.pages import arguments_of, commands, is_operand, overview, page, spelling
from octarm.errors import ExitCode, FileError, OctarmError, closest, printable, quoted

APP = App(
    name="octarm",
    version=lambda: f"octarm {importlib.metadata.version('octarm')}",
    group_arguments=Group("operands"),
    group_parameters=Group("options"),
    default_parameter=Parameter(negative=(), json_list=False, json_dict=False),
)


def completion(shell: Annotated[kinds.Shell, kinds.SHELL], /) -> Work:
    """Print a script by which a shell completes commands.

    Commands, options, names of controllers and references, files and folders.

    Args:
        shell: the shell

    Examples:
      octarm completion bash >> ~/.bashrc
      octarm completion zsh >> ~/.zshrc
      octarm completion fish > ~/.config/fish/completions/octarm.fish
    """
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
        work: Work = functools.partial(print, overview(APP) if name is None else page(APP, name))
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
        case UnknownCommandError():
            return f"unknown command {quoted(command)}{closest(command, commands(APP))}"
        case UnknownOptionError():
            return _no_such_option(command, (error.token.keyword or error.token.value))
        case UnusedCliTokensError(unused_tokens=[word, *_]):
            return f"octarm {command} has no use for {quoted(word)}{_as_option(command, word)}"
        case RepeatArgumentError():
            return f"{error.token.keyword} is given twice"
        case ConsumeMultipleError(argument=Argument() as argument):
            return f"{argument.name} takes one value at most"
        case MissingArgumentError(argument=Argument() as argument) if is_operand(argument):
            known = {spelling(a): a.parameter.help for a in arguments_of(APP, command)}
            return f"octarm {command} needs {spelling(argument)}, {known[spelling(argument)]}"
        case MissingArgumentError(argument=Argument() as argument):
            return f"{argument.name} needs a value after it"
        case CoercionError(msg=str() as sentence):
            return sentence
        case CoercionError(token=token) if token is not None:
            return f"{token.keyword} is {quoted(token.value)}; it is a flag and takes no value"
        case _:
            return " ".join(str(error).split())


def _as_option(command: str, word: str) -> str:
    """What a word may have meant that lacks the dashes of an option."""
    name, equals, value = word.lstrip("-").partition("=")
    option = f"--{name.replace('_', '-')}"
    if option not in map(spelling, arguments_of(APP, command)):
        return ""
    return f", did you mean {printable(option + equals + value, 80)}?"


def _no_such_option(command: str, word: str) -> str:
    owners = [n for n in commands(APP) if word in map(spelling, arguments_of(APP, n))]
    if owners:
        return f"octarm {command} has no option {word}; it belongs to octarm {', '.join(owners)}"
    known = [spelling(a) for a in arguments_of(APP, command) if not is_operand(a)]
    return f"octarm {command} has no option {quoted(word)}{closest(word, known)}"

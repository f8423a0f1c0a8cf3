"""Scripts by which shells complete commands, options and their values."""

from __future__ import annotations

import shlex
from collections.abc import Iterator

from octarm.errors import ExitCode, OctarmError, closest
from octarm.options.argument import Operand, Option
from octarm.options.machine import Completion
from octarm.options.parser import Argument, arguments_of, summary
from octarm.options.table import COMMANDS
from octarm.options.words import SHELLS, known_words

_FOLDERS = ("DIR", "SWEEP")
_FILES = ("RUN", "GAINS")  # beside all kinds of values that are spelt with an ending or FILE

# Words and files are what may stand at the cursor; zsh runs the same script by its bashcompinit.
_BASH = """\
# Completion of octarm for {shell}.
{before}_octarm() {{
  local cur=$2 prev=$3 command=${{COMP_WORDS[1]}} words= files= options=
  if [ "$COMP_CWORD" -eq 1 ]; then
    words="{commands} --help --version"
  else
    case "$command" in
{options}
    esac
    case "$command $prev" in
{values}
    esac
    case "$cur" in -*) words=$options files= ;; esac
  fi
  COMPREPLY=($(compgen -W "$words" -- "$cur"))
  if [ -n "$files" ]; then
    compopt -o filenames 2>/dev/null  # zsh has none
    local IFS=$'\\n'
    COMPREPLY+=($(compgen "$files" -- "$cur"))
  fi
}}
complete -F _octarm octarm
"""
_ZSH = "autoload -U +X compinit && compinit\nautoload -U +X bashcompinit && bashcompinit\n"


def completion(options: Completion) -> int:
    """`octarm completion`: prints the script for a shell.

    Raises:
        ValueError: for an unknown shell.
    """
    if options.shell not in SHELLS:
        raise OctarmError(f"unknown shell {options.shell!r}{closest(options.shell, SHELLS)}")
    print("\n".join(_fish()) if options.shell == "fish" else _bash(options.shell))
    return ExitCode.FINE


def _bash(shell: str) -> str:
    options: list[str] = []
    values: list[str] = []
    for name, kind in COMMANDS.items():
        arguments = arguments_of(kind)
        flags = [a.flag for a in arguments if isinstance(a.mark, Option)]
        operands = [a for a in arguments if isinstance(a.mark, Operand)]
        line = f'options="{" ".join([*flags, "--help"])}"'
        line += f" {_expected(operands[0])}" if operands else " words=$options"
        options.append(f"      {name}) {line} ;;")
        takers = [a for a in arguments if isinstance(a.mark, Option) and a.kind is not bool]
        values += [f'      "{name} {a.flag}") {_expected(a)} options= ;;' for a in takers]
    return _BASH.format(
        shell=shell,
        before=_ZSH if shell == "zsh" else "",
        commands=" ".join(COMMANDS),
        options="\n".join(options),
        values="\n".join(values),
    ).rstrip("\n")


def _expected(argument: Argument) -> str:
    """What may stand where a value is due."""
    files = {"folders": "-d", "files": "-f", "": ""}[_place(argument.mark.value)]
    return f'words="{" ".join(_words(argument))}" files={files}'


def _words(argument: Argument) -> list[str]:
    value = argument.mark.value
    return ["tuned", "recommended"] if value == "GAINS" else known_words(value)


def _place(value: str) -> str:
    """Whether a kind of value is a folder or a file."""
    if value in _FOLDERS:
        return "folders"
    return "files" if value in _FILES or "FILE" in value or "." in value else ""


def _fish() -> Iterator[str]:
    yield "# Completion of octarm for fish."
    yield "complete -c octarm -f"
    first = "complete -c octarm -n __fish_use_subcommand"
    yield f"{first} -l help -d 'show all commands'"
    yield f"{first} -l version -d 'show the version'"
    for name, kind in COMMANDS.items():
        yield f"{first} -a {name} -d {shlex.quote(summary(kind))}"
        here = f"complete -c octarm -n '__fish_seen_subcommand_from {name}'"
        yield f"{here} -l help -d 'show the page of the command'"
        for a in arguments_of(kind):
            spelt = "" if isinstance(a.mark, Operand) else f" -l {a.flag.removeprefix('--')}"
            value = "" if a.kind is bool or not spelt else " -x"
            words = f" -a {shlex.quote(' '.join(_words(a)))}" if _words(a) else ""
            files = {"folders": " -a '(__fish_complete_directories)'", "files": " -F", "": ""}
            place = files[_place(a.mark.value)].replace(" -F", " -F" if not value else " -r -F")
            value = "" if " -r" in place else value
            text = "" if not spelt else f" -d {shlex.quote(a.mark.text)}"
            yield f"{here}{spelt}{value}{words}{place}{text}"

"""What the declarations of commands are made of: kinds of values, known words and headings.

A command is declared by a function: its parameters are the options and operands, its docstring has
the text of the help page. Called, it imports the modules that it needs and returns the work.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from cyclopts import Group, Parameter, Token

Work = Callable[[], int]  # what a command does, once it begins; returns the exit code

Shell = Literal["bash", "zsh", "fish"]
SHELLS: tuple[Shell, ...] = get_args(Shell)


def known_words(value: str) -> list[str]:
    """The words that a kind of value can be, such as CONTROLLER; none when there is no list."""
    match value:
        case "CONTROLLER":
            from controllers import CONTROLLERS

            return list(CONTROLLERS)
        case "REFERENCE":
            from octarm.references import REFERENCES

            return list(REFERENCES)
        case "DISTURBANCE":
            from octarm.disturbances.catalogue import DISTURBANCES

            return list(DISTURBANCES)
        case "ACTUATION":
            from octarm.arm.actuation import ACTUATIONS

            return list(ACTUATIONS)
        case "SHELL":
            return list(SHELLS)
        case "GAINS":
            return ["tuned", "recommended", *map(str, sorted(Path().glob("*.toml")))]
        case _:
            return []


def _numbers(read: Callable[[str], float], needed: str) -> Callable[[Any, Sequence[Token]], Any]:
    """A converter of words to numbers; its `ValueError` is the sentence for the user."""

    def convert(hint: Any, tokens: Sequence[Token]) -> Any:
        values: list[float] = []
        for token in tokens:
            try:
                values.append(read(token.value))
            except ValueError:
                said = f"{token.keyword} is {token.value!r}; it must be {needed}"
                raise ValueError(said) from None
        return tuple(values) if get_origin(hint) is tuple else values[0]

    return convert


def value(metavar: str) -> Parameter:
    """A kind of value without rules, such as FILE."""
    return Parameter(metavar=metavar)


def _word(metavar: str) -> Parameter:
    return Parameter(metavar=metavar, completer=lambda _: known_words(metavar))


N = Parameter(metavar="N", converter=_numbers(int, "a whole number"))
X = Parameter(metavar="X", converter=_numbers(float, "a number"))
S = Parameter(metavar="S", converter=_numbers(float, "a number"))  # [s]
HZ = Parameter(metavar="HZ", converter=_numbers(float, "a number"))  # [Hz]
RUN = value("RUN")
DIR = value("DIR")
FILE = value("FILE")
CONTROLLER = _word("CONTROLLER")
REFERENCE = _word("REFERENCE")
DISTURBANCE = _word("DISTURBANCE")
ACTUATION = _word("ACTUATION")
GAINS = _word("GAINS")
SHELL = _word("SHELL")


def heading(name: str) -> Parameter:
    """A heading of the help pages, which stand in the order of the options."""
    return Parameter(group=Group(name))


EXPERIMENT = heading("the experiment")
MODEL = heading("the arm, and the model that the controller believes")
GAIN = heading("gains")
SIMULATION = heading("simulation")
SOUGHT = heading("what is sought")
RUNS = heading("the runs, as in octarm run")
OUTPUT = heading("output")

"""What the declarations of commands are made of: kinds of values, checks of files, and headings.

A command is declared by a function: its parameters are the options and operands, its docstring has
the text of the help page. Called, it imports the modules that it needs and returns the work.
"""

from __future__ import annotations

import os
import pkgutil
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Literal, get_args, get_origin

from cyclopts import Group, Parameter, Token

from octarm import units
from octarm.errors import OctarmError, closest, quoted
from octarm.units import ANY, Range, number

Work = Callable[[], int | None]  # what a command does; returns the exit code, if all is not fine

GENERATION = 1224.0  # [s] that one generation of octarm tune simulates

Shell = Literal["bash", "zsh", "fish"]
SHELLS: tuple[Shell, ...] = get_args(Shell)
# What octarm new writes a file of.
NEW_FILES = ("controller", "disturbance", "reference", "metric", "arm", "experiment")

# Where the words of a kind of value stand that has a list of them.
_WORDS = {
    "ARM": "octarm.arm.file:shipped_arms",
    "GAINS": "controllers.gain_sets:CHOICES",
    "CONTROLLER": "controllers:CONTROLLERS",
    "METRIC": "octarm.metrics.table:ACCUMULATORS",
    "REFERENCE": "octarm.references:REFERENCES",
    "DISTURBANCE": "octarm.disturbances.spelling:DISTURBANCES",
    "ACTUATION": "octarm.arm.actuation:ACTUATIONS",
    "INTEGRATOR": "octarm.arm.modes:INTEGRATORS",
    "ENGINE": "octarm.simulation.engines:ENGINES",
    "START": "octarm.simulation.start:STARTS",
    "LAYOUT": "octarm.arm.rod:LAYOUTS",
    "SENSING": "octarm.arm.groups:SENSINGS",
    "SHELL": "octarm.commands.kinds:SHELLS",
    "KIND": "octarm.commands.kinds:NEW_FILES",
}


def known_words(metavar: str) -> list[str]:
    """The words that a kind of value can be, such as CONTROLLER; imports what holds them."""
    from octarm.declared import Declared

    found: Any = pkgutil.resolve_name(_WORDS[metavar])
    table: Any = found() if callable(found) else found
    words: list[str] = table.names() if isinstance(table, Declared) else [*table]
    files = sorted(Path().glob("*.toml")) if metavar in ("ARM", "GAINS") else []
    return [*words, *map(str, files)]


def kind(metavar: str, convert: Callable[[str, str], Any] | None = None) -> Parameter:
    """A kind of value; without a conversion it is the word as it is.

    A conversion is given the option and the word, before anything that takes longer is imported;
    its ValueError is the sentence that refuses the word. A shell asks for the words of a kind that
    has a list of them.
    """

    def converter(hint: Any, tokens: Sequence[Token]) -> Any:
        assert convert is not None
        values = [convert(str(token.keyword), token.value) for token in tokens]
        return tuple(values) if get_origin(hint) is tuple else values[0]

    return Parameter(
        metavar=metavar,
        converter=converter if convert is not None else None,
        completer=(lambda _: known_words(metavar)) if metavar in _WORDS else None,
    )


def _one_of(metavar: str) -> Parameter:
    """A kind of value that has no words but those of its list."""

    def convert(option: str, word: str) -> str:
        if word not in (known := known_words(metavar)):
            raise OctarmError(f"unknown {metavar.lower()} {quoted(word)}{closest(word, known)}")
        return word

    return kind(metavar, convert)


def _declared(metavar: str, *more: str) -> Parameter:
    """A name, or a path of a user's own; more names may be known where it stands.

    Numbers of built-in disturbances and references are looked at, but for one that is to vary.
    """

    def convert(option: str, word: str) -> str:
        word = _absolute(option, word)
        table = pkgutil.resolve_name(_WORDS[metavar])
        table.check(word, *more)
        if metavar == "DISTURBANCE" and table.split(word).word in table:
            from octarm.disturbances.spelling import parse_disturbance
            from octarm.disturbances.varied import is_varied

            if not (more and is_varied(word)):
                parse_disturbance(word)
        elif metavar == "REFERENCE" and table.split(word).word in table:
            from octarm.references import parameters_of

            table.code(word)  # raises for a file that is not there
            parameters_of(word)
        return word

    return kind(metavar, convert)


def _absolute(option: str, word: str) -> str:
    from octarm.declared import absolute

    return absolute(word)


def _checked(metavar: str, place: str) -> Parameter:
    """A word that a function, given by its place, reads without an error."""

    def convert(option: str, word: str) -> str:
        pkgutil.resolve_name(place)(word)
        return word

    return kind(metavar, convert)


def _gains(option: str, word: str) -> str:
    from controllers.gain_sets import CHOICES, gain_set_of, read_gain_set

    if word.endswith(".toml"):
        read_gain_set(word)  # of which controller is known later
    elif word not in CHOICES:
        gain_set_of("", word)  # raises
    return word


def _within(metavar: str, of: Range) -> Parameter:
    def convert(option: str, word: str) -> float:
        value = of.parse(option, word)
        of.check_bounds(option.strip("-").replace("-", "_"), value)
        return value

    return kind(metavar, convert)


def _step(option: str, word: str) -> float | str:
    if word == "auto":
        return word
    from octarm.arm.modes import LONGEST_STEP, SHORTEST_STEP, check_step

    try:
        seconds = Range("s", SHORTEST_STEP, at_most=LONGEST_STEP).parse(option, word)
    except OctarmError as error:
        raise OctarmError(str(error).replace("a number", "a number [s] or auto")) from None
    check_step(seconds)
    return seconds


def _amount(option: str, word: str) -> str:
    """A number whose unit depends on another option."""
    number(option, word, ANY)
    return word


def whole(least: int, most: int = 2**63 - 1) -> Parameter:
    """A whole number; the largest one is what tables and recordings hold."""

    def convert(option: str, word: str) -> int:
        try:
            count = int(word)
        except ValueError:
            raise ValueError(f"{option} is {quoted(word)}; it must be a whole number") from None
        if not least <= count <= most:
            bound = f"at least {least}" if count < least else f"at most {most}"
            raise ValueError(f"{option.strip('-')} is {quoted(count)}; it must be {bound}")
        return count

    return kind("N", convert)


def file(suffix: str = "") -> Parameter:
    """A file to write, in a folder that exists."""

    def convert(option: str, word: str) -> Path:
        path = Path(word)
        if suffix and path.suffix != suffix:
            raise ValueError(f"{option} is {quoted(word)}; its name must end in {suffix}")
        if not path.resolve().parent.is_dir():
            raise ValueError(f"{word} cannot be written: there is no folder for it")
        return path

    return kind(f"FILE{suffix}", convert)


def _live(hint: Any, tokens: Sequence[Token]) -> list[str]:
    """HOST:PORT of each token, given that or the URL that rerun says."""
    addresses: list[str] = []
    for token in tokens:
        url = re.fullmatch(r"(?:rerun\+http://)?([\w.-]+:\d{1,5})(?:/proxy/?)?", token.value, re.A)
        if url is None or int(url[1].rpartition(":")[2]) > 65535:
            raise ValueError(
                f"{token.keyword} is {quoted(token.value)}; an address reads HOST:PORT"
            )
        addresses.append(url[1])
    return addresses


N, COUNT = whole(0), whole(1)
X, S, HZ = (kind(each, Range(unit).parse) for each, unit in (("X", "1"), ("S", "s"), ("HZ", "Hz")))
DURATION = _within("S", Range("s", above=0.0))
SETTLE = _within("S", Range("s", at_least=0.0, at_most=1e9))
BUDGET = _within("S", Range("s", at_least=GENERATION, at_most=1e8))
MISMATCH, PERIOD = kind("X", units.MISMATCH.parse), kind("S", units.PERIOD.parse)
AMOUNT, SHARE = kind("X", _amount), _within("X", units.SHARE)
BOUND = _checked("METRIC:VALUE", "octarm.metrics.table:parse_bound")
STEP = kind("S", _step)
RUN, DIR = kind("RUN"), kind("DIR")
CONTROLLER, REFERENCE, DISTURBANCE, METRIC = map(
    _declared, ("CONTROLLER", "REFERENCE", "DISTURBANCE", "METRIC")
)
VARIED = _declared("DISTURBANCE", "nominal-mismatch")  # see `octarm.disturbances.varied`
CALLED = kind("CONTROLLER", _absolute)  # an operand, or a name in a sweep
COLUMN = kind("METRIC", _absolute)  # of the table of a sweep
ACTUATION, INTEGRATOR, ENGINE, LAYOUT, SENSING, START = map(
    _one_of, ("ACTUATION", "INTEGRATOR", "ENGINE", "LAYOUT", "SENSING", "START")
)
GAINS, ARM = kind("GAINS", _gains), _checked("ARM", "octarm.arm.file:read_arm")
FILE_OR_ARM, SHELL, KIND = map(kind, ("ARM", "SHELL", "KIND"))  # operands: looked at last
# An option whose value may be left out; the value, if there is one, as a list.
LIVE = Parameter(metavar="[HOST:PORT]", converter=_live, consume_multiple=(0, 1))


def check_free(force: bool, *files: Path | None) -> None:
    """Raises OctarmError if one of the files that a command writes is there, unless it is forced.

    A device and a pipe hold nothing that could be lost.
    """
    for path in files if not force else ():
        if path is not None and os.path.isfile(path):  # a name may be too long
            raise OctarmError(
                f"{path} is there already; --force replaces it, or choose another name"
            )


def check_runs(*folders: Path, sweeps: bool = False) -> None:
    """Raises OctarmError if one of the folders holds no run, or no sweep where one may be."""
    from octarm.runs.folder import read_description

    for folder in folders:
        if not (sweeps and os.path.isfile(folder / "manifest.json")):
            read_description(folder)


# The headings of the help pages, which stand in the order of the options.
EXPERIMENT = Parameter(group=Group("the experiment"))
MODEL = Parameter(group=Group("the arm, and the model that the controller believes"))
GAIN = Parameter(group=Group("gains"))
SOURCE = Parameter(group=Group("another source of the arm"))
LOOP = Parameter(group=Group("stability of the sampled loop"))
SIMULATION = Parameter(group=Group("simulation"))
SOUGHT = Parameter(group=Group("what is sought"))
RUNS = Parameter(group=Group("the runs, as in octarm run"))
OUTPUT = Parameter(group=Group("output"))

"""What the declarations of commands are made of: kinds of values, known words and headings.

A command is declared by a function: its parameters are the options and operands, its docstring has
the text of the help page. Called, it imports the modules that it needs and returns the work.
"""

from __future__ import annotations

import math
import os
import pkgutil
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin

from cyclopts import Group, Parameter, Token

from octarm.errors import OctarmError, closest, quoted
from octarm.units import ANY, number

if TYPE_CHECKING:
    from octarm.declared import Declared

Work = Callable[[], int]  # what a command does, once it begins; returns the exit code

Shell = Literal["bash", "zsh", "fish"]
SHELLS: tuple[Shell, ...] = get_args(Shell)
STARTS = ("controller", "disturbance", "reference", "metric", "arm", "experiment")  # of octarm new


# Where the words of a kind of value stand that has a list of them.
_WORDS = {
    "CONTROLLER": "controllers:CONTROLLERS",
    "METRIC": "octarm.metrics.declared:ACCUMULATORS",
    "REFERENCE": "octarm.references:REFERENCES",
    "DISTURBANCE": "octarm.disturbances.spelling:DISTURBANCES",
    "ACTUATION": "octarm.arm.actuation:ACTUATIONS",
    "INTEGRATOR": "octarm.arm.modes:INTEGRATORS",
    "ENGINE": "octarm.simulation.engines:ENGINES",
    "LAYOUT": "octarm.arm.rod:LAYOUTS",
    "SENSING": "octarm.arm.groups:SENSINGS",
    "SHELL": "octarm.commands.kinds:SHELLS",
    "KIND": "octarm.commands.kinds:STARTS",
}


def known_words(kind: str) -> list[str]:
    """The words that a kind of value can be, such as CONTROLLER; imports what holds them."""
    if kind == "GAINS":
        return ["tuned", "recommended", *_files()]
    if kind == "ARM":
        from octarm.arm.file import shipped_arms

        return [*shipped_arms(), *_files()]
    from octarm.declared import Declared

    words = pkgutil.resolve_name(_WORDS[kind])
    return words.names() if isinstance(words, Declared) else list(words)


def _files() -> list[str]:
    return list(map(str, sorted(Path().glob("*.toml"))))


def text(metavar: str) -> Parameter:
    """A kind of value without rules, such as DIR."""
    return Parameter(metavar=metavar)


def _word(metavar: str) -> Parameter:
    """A kind of value with known words, which a shell asks the program for."""
    return Parameter(metavar=metavar, completer=lambda _: known_words(metavar))


def _one_of(metavar: str) -> Parameter:
    """The same, for which there are no other words."""

    def convert(option: str, word: str) -> str:
        if word not in (known := known_words(metavar)):
            raise OctarmError(f"unknown {metavar.lower()} {quoted(word)}{closest(word, known)}")
        return word

    return _converted(metavar, convert, completer=lambda _: known_words(metavar))


def _arm(option: str, word: str) -> str:
    from octarm.arm.file import read_arm

    read_arm(word)  # raises, before anything that takes longer is imported
    return word


def _duration(option: str, word: str) -> float:
    seconds = number(option, word, "s")
    if not seconds > 0.0:
        raise OctarmError(f"duration is {seconds:g} s; it must be positive")
    return seconds


def _gains(option: str, word: str) -> str:
    from controllers.gain_sets import gain_set_of, read_gain_set

    if word.endswith(".toml"):
        read_gain_set(word)
    elif word not in ("tuned", "recommended"):
        gain_set_of("", word)  # raises
    return word


def check(metavar: str, word: str, *more: str) -> None:
    """Raises OctarmError for a word that can mean nothing of a kind, such as CONTROLLER.

    Nothing that takes long is imported for that. More names may be known where the word stands.
    """
    if metavar == "ARM":
        _arm("", word)
    elif word not in more:
        table: Declared[Any] = pkgutil.resolve_name(_WORDS[metavar])
        name = table.split(word).word
        if name not in table and name not in more:
            table.check(word if table.kind in ("controller", "metric") else name, *more)


def _declared(metavar: str, *more: str, known: bool = True) -> Parameter:
    """A name, or an import path or file of a user's own; see `octarm.declared`.

    More names may be known, or others than those of octarm; what is not `known` yet is an operand,
    which is to be looked at after all options, or a name of a sweep.
    """

    def convert(option: str, word: str) -> str:
        from octarm.declared import absolute

        word = absolute(word)
        if known:
            check(metavar, word, *more)
        return word

    return _converted(metavar, convert, completer=lambda _: known_words(metavar))


def _converted(
    metavar: str,
    convert: Callable[[str, str], Any],
    completer: Callable[[Any], list[str]] | None = None,
) -> Parameter:
    """A kind of value that an option and a word are converted to; a ValueError is the sentence."""

    def converter(hint: Any, tokens: Sequence[Token]) -> Any:
        values = [convert(str(token.keyword), token.value) for token in tokens]
        return tuple(values) if get_origin(hint) is tuple else values[0]

    return Parameter(metavar=metavar, converter=converter, completer=completer)


def _real(unit: str, least: float = -math.inf) -> Callable[[str, str], float]:
    def convert(option: str, word: str) -> float:
        value = number(option, word, unit)
        if least > -math.inf and not least <= value < math.inf:
            raise ValueError(
                f"{option} is {quoted(word)}; it must be at least {least:g} and finite"
            )
        return value

    return convert


def _number_as_text(option: str, word: str) -> str:
    number(option, word, ANY)
    return word


_LARGEST = 2**63 - 1  # that tables and recordings hold


def _whole(least: int, most: int = _LARGEST) -> Callable[[str, str], int]:
    def convert(option: str, word: str) -> int:
        try:
            number = int(word)
        except ValueError:
            raise ValueError(f"{option} is {quoted(word)}; it must be a whole number") from None
        if number < least:
            name = option.strip("-")
            raise ValueError(f"{name} is {quoted(number)}; it must be at least {least}")
        if number > most:
            name = option.strip("-")
            raise ValueError(f"{name} is {quoted(number)}; it must be at most {most}")
        return number

    return convert


def file(suffix: str = "") -> Parameter:
    """A file to write, in a folder that exists."""

    def convert(option: str, word: str) -> Path:
        path = Path(word)
        if suffix and path.suffix != suffix:
            raise ValueError(f"{option} is {quoted(word)}; its name must end in {suffix}")
        if not path.resolve().parent.is_dir():
            raise ValueError(f"{word} cannot be written: there is no folder for it")
        return path

    return _converted(f"FILE{suffix}", convert)


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
    """Raises OctarmError if one of the folders holds no run, or no sweep where one may be.

    Nothing that takes long is imported for that.
    """
    from octarm.runs.folder import read_description

    for folder in folders:
        if not (sweeps and os.path.isfile(folder / "manifest.json")):
            read_description(folder)


def refusal(folder: Path, file: str, what: str) -> Work | None:
    """What refuses a folder that is not `what`, before anything that takes long is imported."""

    def refuse() -> int:
        raise OctarmError(f"{folder} is not {what}: it has no {file}")

    return None if os.path.isfile(folder / file) else refuse


def whole(least: int, most: int) -> Parameter:
    """A whole number of what takes a whole machine, or hours, beyond the largest one."""
    return _converted("N", _whole(least, most))


N, COUNT = _converted("N", _whole(0)), _converted("N", _whole(1))


def _step(option: str, word: str) -> float | str:
    if word == "auto":
        return word
    try:
        return number(option, word, "s")
    except OctarmError as error:
        raise OctarmError(str(error).replace("a number", "a number [s] or auto")) from None


STEP = _converted("S", _step)
X = _converted("X", _real("1"))
S = _converted("S", _real("s"))
DURATION, SETTLE = _converted("S", _duration), _converted("S", _real("s", 0.0))
HZ = _converted("HZ", _real("Hz"))
AMOUNT = _converted("X", _number_as_text)  # a number whose unit depends on another option
RUN, DIR = text("RUN"), text("DIR")
CONTROLLER, REFERENCE, DISTURBANCE, METRIC = map(
    _declared, ("CONTROLLER", "REFERENCE", "DISTURBANCE", "METRIC")
)
VARIED = _declared("DISTURBANCE", "nominal-mismatch")  # see `octarm.sweeps.margin`
CALLED, COLUMN = (
    _declared("CONTROLLER", known=False),
    _declared("METRIC", known=False),
)  # in a sweep
ACTUATION, INTEGRATOR, ENGINE = map(_one_of, ("ACTUATION", "INTEGRATOR", "ENGINE"))
LAYOUT = _one_of("LAYOUT")
SENSING = _one_of("SENSING")
GAINS = _converted("GAINS", _gains, completer=lambda _: known_words("GAINS"))
# Operands, which are looked at after all options.
FILE_OR_ARM, SHELL, KIND = map(_word, ("ARM", "SHELL", "KIND"))
ARM = _converted("ARM", _arm, completer=lambda _: known_words("ARM"))


def _address(option: str, word: str) -> str:
    """HOST:PORT, given that or the URL that rerun says."""
    match = re.fullmatch(r"(?:rerun\+http://)?([\w.-]+:\d{1,5})(?:/proxy/?)?", word, re.ASCII)
    if match is None or int(match[1].rpartition(":")[2]) > 65535:
        raise ValueError(f"{option} is {quoted(word)}; an address reads HOST:PORT")
    return match[1]


def _live(hint: Any, tokens: Sequence[Token]) -> list[str]:
    return [_address(str(token.keyword), token.value) for token in tokens]


# An option whose value may be left out; the value, if there is one, as a list.
LIVE = Parameter(metavar="[HOST:PORT]", converter=_live, consume_multiple=(0, 1))


def heading(name: str) -> Parameter:
    """A heading of the help pages, which stand in the order of the options."""
    return Parameter(group=Group(name))


EXPERIMENT = heading("the experiment")
MODEL = heading("the arm, and the model that the controller believes")
GAIN = heading("gains")
SOURCE = heading("another source of the arm")
LOOP = heading("stability of the sampled loop")
SIMULATION = heading("simulation")
SOUGHT = heading("what is sought")
RUNS = heading("the runs, as in octarm run")
OUTPUT = heading("output")

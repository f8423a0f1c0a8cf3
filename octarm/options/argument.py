"""How the fields of a command's description are written on the command line."""

from __future__ import annotations

import dataclasses


@dataclasses.dataclass(frozen=True)
class Option:
    """A field that is given by name, such as `--seed 3`; a tuple of them by several such pairs.

    A field of type bool is a flag, which has no value.

    Attributes:
        value: what kind of value it takes, in capitals: S for seconds, FILE, CONTROLLER, ...
        text: what it is for, with the unit; what happens without it, if its default is None.
        section: heading under which the help shows it.
    """

    value: str
    text: str
    section: str = "options"


@dataclasses.dataclass(frozen=True)
class Operand:
    """A field that is given by its place, such as RUN in `octarm replay RUN`.

    Attributes:
        value: what kind of value it is, in capitals.
        text: what it is for.
    """

    value: str
    text: str

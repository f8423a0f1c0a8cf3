"""Arms as TOML files: numbers with their units, by name, for any number of modules.

    name = "two modules"
    mass = { value = [300, 200], unit = "g" }      one number a module, or one for all of them
    inertia = "600 kg mm^2"
    width = "80 mm"                                between the two columns of a module
    rest_length = "120 mm"
    stiffness = "1.2 N/mm"                         of each column
    damping = "12 N s/m"                           of each column; or damping_time = "10 ms"
    input_range = { value = [-12, 12], unit = "N" }

What belongs to columns may have a row for each of the two, of one number or one a module: `value =
[[1200, 1000], [1100, 900]]`, column 1 first, the one that lengthens with a positive bend. An input
range is a pair (low, high), or two rows of one number a module or a column.

`axial_stiffness`, `bending_stiffness`, `axial_damping` and `bending_damping` are those of a whole
module where they are not what its columns give; with both stiffnesses the columns need none. There
are also `modules` (needed where no list says how many), `gravity`, `tip_length` and `rest_angle`
(the bend of a module without force), and `source`, `converted` and `assumed` for people.

Instead of all this a table `[rod]` may give `length`, `EA`, `EI`, `density`, `rotary_inertia`,
`damping_time`, `modules` and `layout`, see `octarm.arm.rod`; a list of two values tapers.
"""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np

from octarm.arm.file_content import KINDS, ArmFile, parameters_of
from octarm.arm.lagrange import equilibrium
from octarm.arm.limits import Limits
from octarm.arm.parameters import ArmParameters
from octarm.errors import OctarmError, closest, quoted
from octarm.formats import Document, read_toml, to_toml
from octarm.units import UNITS

SHIPPED = Path(__file__).resolve().parent.parent / "arms"


@dataclasses.dataclass(frozen=True, eq=False)
class Arm:
    """An arm, and what its file says of its numbers to people.

    In sentences: their source, what was converted from what that gives, and what was assumed.
    """

    parameters: ArmParameters
    name: str = ""
    source: tuple[str, ...] = ()
    converted: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()


def shipped_arms() -> dict[str, Path]:
    """The files of the arms that come with octarm, by name."""
    return {path.stem: path for path in sorted(SHIPPED.glob("*.toml"))}


def read_arm(path: str | Path) -> ArmParameters:
    """The arm in a TOML file, or one that comes with octarm, by name, such as `eth`.

    Raises OctarmError if it is not an arm, or cannot hang, with the line, or FileError.
    """
    return read_arm_file(path).parameters


def read_arm_file(path: str | Path) -> Arm:
    """The same with what the file says of the arm."""
    known = shipped_arms()
    if str(path) in known:
        path = known[str(path)]
    elif Path(path).suffix != ".toml":
        raise OctarmError(
            f"unknown arm {quoted(str(path))}{closest(str(path), known)}, or a file NAME.toml"
        )
    return arm_of(read_toml(path))


def arm_of(document: Document, *keys: str) -> Arm:
    """The arm in a document, or in the table of it with these keys; see `read_arm`."""
    content = document.read(ArmFile, *keys)
    try:
        parameters = parameters_of(content)
        violation = cannot_hang(parameters)
    except OctarmError as error:
        named = str(error).partition(" ")[0]
        inner = ("rod", named) if content.rod is not None else (named,)
        raise document.error(str(error), *keys, *inner) from None
    if violation:
        raise document.error(violation, *keys)
    source = (content.source,) if isinstance(content.source, str) else content.source
    return Arm(
        parameters, content.name, tuple(filter(None, source)), content.converted, content.assumed
    )


def cannot_hang(p: ArmParameters) -> str:
    """Why one arm cannot hang within its limits, a sentence; empty if it can.

    Raises OctarmError if there is no equilibrium.
    """
    rest = equilibrium(p)
    broken = Limits.of(p).violation(rest, np.zeros_like(rest))
    return f"this arm cannot hang in one piece: at rest {broken}" if broken else ""


def arm_toml(arm: Arm) -> str:
    """The text of a file that `read_arm` makes this arm of, in SI units, to twelve digits."""
    p = arm.parameters
    words = {
        name: getattr(arm, name) or None for name in ("name", "source", "converted", "assumed")
    }
    lever = 0.25 * p.widths * p.widths
    always = ("mass", "inertia", "width", "rest_length", "stiffness", "damping", "gravity")
    rows: dict[str, np.ndarray] = {name: getattr(p, name) for name in always}
    if np.any(p.rest_angle):
        rows["rest_angle"] = p.rest_angle
    for what, backbone in (("stiffness", p.backbone_stiffness), ("damping", p.backbone_damping)):
        if np.any(backbone):
            both = getattr(p, what).sum(axis=0)
            rows[f"axial_{what}"] = both + backbone[0]
            rows[f"bending_{what}"] = lever * both + backbone[1]
    if np.any(p.tip_length):
        rows["tip_length"] = p.tip_length
    if np.any(np.isfinite(p.input_range)):
        alike = p.input_range.shape[-1] == 1
        rows["input_range"] = p.input_range[:, 0] if alike else p.input_range
    lines = [_line(name, value, next(iter(UNITS[KINDS[name]]))) for name, value in rows.items()]
    return to_toml({**words, "modules": p.modules}) + "".join(lines)


def _line(name: str, value: np.ndarray, unit: str) -> str:
    """A quantity as a file has it: one for all modules and columns alike, or a list."""
    numbers = [float(f"{x:.12g}") for x in value.ravel().tolist()]
    value = np.reshape(numbers, value.shape)
    if value.ndim == 2 and np.array_equal(value[0], value[1]):
        value = value[0]
    if value.ndim < 2 and np.all(value == value.flat[0]):
        return f'{name} = "{value.flat[0].item()!r} {unit}"\n'
    return f'{name} = {{ value = {value.tolist()!r}, unit = "{unit}" }}\n'

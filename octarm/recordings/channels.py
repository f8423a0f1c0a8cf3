"""What a run holds, as named channels with units and bounds, and the phases that it goes through.

A channel is what is recorded and plotted together: an array of the loop or a signal of the
controller. The names of its numbers suit the columns of a table: `theta1`, `column_2_3`, or `s1_4`
for the fourth rule of s1.

Channels are recorded in double precision at every control instant, but for what follows from others
and what adapts slowly, see `_MEANINGS`. Signals with a number for each fuzzy rule are a picture.

Lengths, angles, moments and energies are recorded in thousandths, mm and mrad, which people read:
the viewer plots numbers as they are.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np

from octarm.arrays import Coordinates, planar_coordinates
from octarm.disturbances.ledger import Drawn
from octarm.disturbances.spelling import from_entry
from octarm.interfaces import WITHIN, Rows

# The fields of `Rows` that the loop itself provides; all others are the controller's signals.
_LOOP = ("t", "q", "v", "q_d", "v_d", "tau", "force", "disturbance", *WITHIN)

# Units that recordings have instead of those of the SI, and figures where numbers are small.
_LARGE = ("m", "m/s", "m s", "rad", "rad/s", "rad s", "N m", "J", "W")
THOUSANDTHS = {unit: f"m{unit}" for unit in _LARGE}


class _Meaning(NamedTuple):
    units: Mapping[str, str] = {}  # by the unit of the coordinates; under "" for other channels
    title: str = ""
    single: bool = False  # whether single precision is enough
    slow: bool = False  # whether 60 rows a second are enough


_LENGTH, _RATE = {"m": "m", "rad": "rad"}, {"m": "m/s", "rad": "rad/s"}
_FORCE = {"m": "N", "rad": "N m"}
_MEANINGS = {
    "q": _Meaning(_LENGTH, "coordinates q"),
    "q_d": _Meaning(_LENGTH),
    "error": _Meaning(_LENGTH, "error q - q_d", single=True),
    "q_measured": _Meaning(_LENGTH, "measured q", single=True),
    "v_measured": _Meaning(_RATE, "measured q'", single=True),
    "plant_q": _Meaning(title="coordinates of the plant", single=True),
    "plant_tip": _Meaning({"": "m"}, "tip of the plant"),
    "s": _Meaning(_RATE, single=True),
    "integral": _Meaning({"m": "m s", "rad": "rad s"}),
    "disturbance": _Meaning(_FORCE, single=True),
    "equivalent": _Meaning(_FORCE, "equivalent part", single=True),
    "switching": _Meaning(_FORCE, "robust part", single=True),
    "f_hat": _Meaning(_FORCE, "estimate f^", single=True),
    "feedback": _Meaning(single=True),
    "fuzzy": _Meaning(single=True),
    "E": _Meaning(_FORCE, single=True, slow=True),
    "K": _Meaning(_FORCE),
    "tau": _Meaning({"": "N"}, "input tau"),
    "V": _Meaning({"": "J"}, "Lyapunov function V"),
    "reaching_bound": _Meaning({"": "s"}),
}


def _known(name: str) -> _Meaning:
    return _MEANINGS.get(name, _Meaning())


class Bound(NamedTuple):
    """What bounds a channel, and what the bound is called.

    Attributes:
        values: one for each coordinate or input, shape (2N,).
        both_sides: whether minus the bound is a bound as well.
    """

    values: np.ndarray
    word: str
    both_sides: bool = True

    def lines(self, part: slice = slice(None)) -> list[float]:
        """Where lines belong in a plot of some of the numbers."""
        distinct = sorted(set(self.values[part].tolist()))
        return [*distinct, *(-x for x in distinct)] if self.both_sides else distinct


class Channel(NamedTuple):
    """Numbers of one meaning.

    Attributes:
        name: of letters, digits and underscores.
        field: name of the field of `Rows`; empty for the error q - q_d, which is computed.
        kind: one number for each coordinate, for each input, or for the arm; a list of numbers; or
            one number for each fuzzy rule of each coordinate.
        parts: where the numbers stand that are plotted together, by the name of the group; one
            part under "" unless the channel is of coordinates.
        units: unit of each part in brackets, after a space; empty when unknown.
    """

    name: str
    field: str
    kind: Literal["coordinates", "inputs", "scalar", "list", "rules"]
    names: Sequence[str]
    parts: Mapping[str, slice]
    units: Mapping[str, str]
    bound: Bound | None = None

    @property
    def title(self) -> str:
        """What it is, in words where there are some."""
        return _known(self.name).title or self.name

    def label(self, part: str) -> str:
        """The title of a part."""
        return f"{self.title}, {part}" if part else self.title

    @property
    def entity(self) -> str:
        """Entity of a recording, and the structure of lists in it, that holds the numbers."""
        return "adaptation" if _known(self.name).slow else "signals"

    def column(self, part: str) -> str:
        """Name of the list of the numbers of a part in that structure."""
        return f"{self.name}_{part}" if part else self.name

    def recorded(self, part: str) -> tuple[float, str]:
        """What the numbers of a part are multiplied by in a recording, and their unit there."""
        unit = self.units[part].strip(" []")
        return (1e3, f" [{THOUSANDTHS[unit]}]") if unit in THOUSANDTHS else (1.0, self.units[part])

    def lines(self, part: str) -> np.ndarray:
        """Where lines at the bound belong in a plot of a part, as recorded, shape (lines,)."""
        lines = [] if self.bound is None else self.bound.lines(self.parts[part])
        return self.recorded(part)[0] * np.array(lines)

    def values(self, rows: Rows) -> np.ndarray:
        """The numbers of k instants, shape (k, numbers)."""
        if not self.field:
            return rows["q"] - rows["q_d"]
        return rows[self.field].reshape(len(rows["t"]), -1)

    def columns(self, values: np.ndarray) -> dict[str, np.ndarray]:
        """The numbers, shape (k, numbers), as they are recorded: part by part, by `column`."""
        kind = np.float32 if _known(self.name).single else values.dtype
        with np.errstate(over="ignore"):  # a diverged arm may be anywhere
            return {
                self.column(name): (self.recorded(name)[0] * values[:, part]).astype(kind)
                for name, part in self.parts.items()
            }


def coordinates_of(description: Mapping[str, Any]) -> Coordinates:
    """The coordinates of the arm that `run.json` describes."""
    return planar_coordinates(len(description["parameters"]["mass"]))


def disturbances_of(description: Mapping[str, Any]) -> list[Drawn]:
    """How the disturbances of `run.json` are drawn; no code is imported."""
    return [
        Drawn.model_validate(entry["drawn"]) if entry.get("drawn") else Drawn.of(from_entry(entry))
        for entry in description.get("disturbances", [])
    ]


def channels_of(
    rows: Rows, description: Mapping[str, Any], layer: np.ndarray | None, *, disturbed: bool
) -> dict[str, Channel]:
    """The channels of a run by name, given some of its instants and what `run.json` has of it.

    The layer has shape (2N,) [m/s], [rad/s]; the force of disturbances is one of the channels if
    the run is `disturbed`.
    """
    coordinates, bounds = coordinates_of(description), bounds_of(description, layer)
    count = len(coordinates.names)
    channels: dict[str, Channel] = {}

    def add(field: str, kind: Any, names: Sequence[str] = (), name: str = "") -> None:
        if not name:  # one of letters, digits and underscores that no other channel has
            name = re.sub(r"\W", "_", field, flags=re.ASCII)
            name = name if name[:1].isalpha() else f"x{name}"
            while name in channels:
                name += "_"
        units, parts, of = _known(name).units, {"": slice(None)}, {"": ""}
        if kind == "coordinates":
            names, parts = coordinates.names, dict(coordinates.groups)
            of = {group: coordinates.units[part][0] for group, part in parts.items()}
        brackets = {part: f" [{units[of[part]]}]" if of[part] in units else "" for part in parts}
        bound = bounds.get(name)
        channels[name] = Channel(name, field, kind, names or [name], parts, brackets, bound)

    add("q", "coordinates")
    add("q_d", "coordinates")
    add("", "coordinates", name="error")
    add("tau", "inputs", coordinates.inputs)
    if disturbed:
        add("disturbance", "coordinates")
    for field, array in rows.items():
        shape = array.shape[1:]
        width = int(np.prod(shape))
        if field in _LOOP or not width:
            continue
        if len(shape) == 2 and shape[0] == count:
            rules = range(1, shape[1] + 1)
            add(field, "rules", [f"{name}_{k}" for name in coordinates.names for k in rules])
        elif shape == (count,):
            add(field, "coordinates")
        elif width == 1:
            add(field, "scalar")
        else:
            add(field, "list", [f"x{k + 1}" for k in range(width)])
    return channels


def has_sliding(channels: Mapping[str, Channel]) -> bool:
    """Whether the controller has a sliding variable s and a robust part, for each coordinate."""
    kinds = [channels[name].kind for name in ("s", "switching") if name in channels]
    return kinds == ["coordinates"] * 2


def has_energy(channels: Mapping[str, Channel]) -> bool:
    """Whether the controller reports one Lyapunov function V."""
    return "V" in channels and channels["V"].kind == "scalar"


def bounds_of(description: Mapping[str, Any], layer: np.ndarray | None) -> dict[str, Bound]:
    """What bounds the channels of a run, by the name of the channel, as far as it is known.

    s is bounded by the boundary layer phi, shape (2N,) [m/s], [rad/s], and tau by what a
    disturbance limits the inputs to. Two gains are known here, and nowhere else, by their names:
    `lambda_`, the slope of the sliding variable s = e' + lambda e, by which the layer bounds the
    error, |e| <= phi / lambda, and `E_max`, onto which the gain E is projected.
    """
    gains = description.get("controller", {}).get("gains", {})
    shape = (len(coordinates_of(description).names),)
    bounds: dict[str, Bound] = {}
    slope, largest = (_positive(gains.get(name), shape) for name in ("lambda_", "E_max"))
    if (phi := _positive(layer, shape)) is not None:
        bounds["s"] = Bound(phi, "phi")
        if slope is not None:
            bounds["error"] = Bound(phi / slope, "phi / lambda")
    if largest is not None:
        bounds["E"] = Bound(largest, "E_max", both_sides=False)
    limits = [disturbance.bound for disturbance in disturbances_of(description)]
    known = [np.broadcast_to(limit, shape) for limit in limits if limit is not None]
    if known and np.all(np.isfinite(known)):
        bounds["tau"] = Bound(np.min(known, axis=0), "limit")
    return bounds


class Phases:
    """Watches a run block by block and reports the changes of phase, lane by lane.

    If the controller has a robust part, the signal `switching`, a coordinate is `sliding` while
    |s| <= phi; without a boundary layer it slides from the instant at which s first has another
    sign than at the start. The lane `surface` is `sliding` while all coordinates are;
    `each/theta1` is the lane of one. The lane `inputs` is `saturated` while one input is at its
    limit.
    """

    def __init__(
        self, names: Sequence[str], layer: np.ndarray | None, limit: np.ndarray | None
    ) -> None:
        """Phases for a layer phi and a limit of the inputs [N], each of shape (2N,)."""
        self._names, self._layer, self._limit = names, layer, limit
        self._start: np.ndarray | None = None  # sign of s
        self._reached = np.zeros(len(names), dtype=bool)
        self._last: dict[str, bool] = {}

    def changes(self, rows: Rows) -> dict[str, list[tuple[int, str]]]:
        """The rows of this block at which a lane changes and its phase from there on, by lane."""
        changes: dict[str, list[tuple[int, str]]] = {}

        def add(lane: str, flags: np.ndarray, *words: str) -> None:
            at = np.flatnonzero(np.diff(flags, prepend=self._last.get(lane, not flags[0])))
            self._last[lane] = bool(flags[-1])
            if at.size:
                changes[lane] = [(int(row), words[int(flags[row])]) for row in at]

        s = rows.get("s") if "switching" in rows else None  # else s is only a filtered error
        if s is not None and s.shape[1:] == (len(self._names),):
            sliding = self._sliding(s)
            add("surface", np.all(sliding, axis=1), "reaching", "sliding")
            for name, flags in zip(self._names, sliding.T, strict=True):
                add(f"each/{name}", flags, "reaching", "sliding")
        if self._limit is not None:
            full = np.any(np.abs(rows["tau"]) >= self._limit, axis=1)
            add("inputs", full, "free", "saturated")
        return changes

    def _sliding(self, s: np.ndarray) -> np.ndarray:
        """Whether each coordinate slides, for s of shape (k, 2N)."""
        if self._layer is not None:
            return np.abs(s) <= self._layer
        if self._start is None:
            self._start = np.sign(s[0])
        reached = np.logical_or.accumulate(s * self._start <= 0.0, axis=0) | self._reached
        self._reached = reached[-1]
        return reached


def _positive(value: Any, shape: tuple[int, ...]) -> np.ndarray | None:
    """The value broadcast to this shape if it is made of positive, finite numbers, else None."""
    try:
        array = np.broadcast_to(np.asarray(value, dtype=float), shape)
    except (TypeError, ValueError):
        return None
    return array if np.all(np.isfinite(array)) and np.all(array > 0.0) else None

"""What a run holds, as named channels with units: the arrays of the loop and the controller's.

A channel is what is recorded and plotted together. Its names suit a column of a table: `theta1`,
`column_2_3`, or `s1_4` for the fourth rule of s1.

q, q_d, tau and V are recorded with all their bits at every control instant, and so is what is not
known here. What follows from them, s, and the parts that a force is the sum of, are recorded with
single precision; the gain E, which adapts slowly, so too and 60 times a second. What has a number
a rule is recorded as a picture.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

import numpy as np

from octarm.arm.mjcf import coordinate_names
from octarm.simulation.trajectory import Trajectory

Kind = Literal["coordinates", "inputs", "scalar", "list", "rules"]

_UNITS: dict[str, tuple[str, ...]] = {  # of slides and bends, or of the one number
    "q": ("m", "rad"),
    "q_d": ("m", "rad"),
    "error": ("m", "rad"),
    "q_measured": ("m", "rad"),
    "v_measured": ("m/s", "rad/s"),
    "s": ("m/s", "rad/s"),
    "tau": ("N",),
    "V": ("J",),
    "V_rate": ("W",),
    "V_claim": ("W",),
    "integral": ("m s", "rad s"),
    "reaching_bound": ("s",),
    **dict.fromkeys(
        ("equivalent", "switching", "disturbance", "f_hat", "E", "K", "force"), ("N", "N m")
    ),
    "alpha": ("1",),
    "sigma": ("1",),
}

_POSITIVE = ("E",)
_SLOW = ("E",)
_SINGLE = (*_SLOW, "error", "s", "disturbance", "equivalent", "switching", "feedback", "fuzzy",
           "f_hat", "q_measured", "v_measured")  # fmt: skip

MEANINGS = {
    "q": "coordinates q",
    "error": "error q - q_d",
    "s": "s",
    "tau": "input tau",
    "equivalent": "equivalent part",
    "switching": "robust part",
    "V": "Lyapunov function V",
    "f_hat": "estimate f^",
    "E": "E",
    "disturbance": "disturbance",
    "q_measured": "measured q",
    "v_measured": "measured q'",
}


class Channel(NamedTuple):
    """Numbers of one meaning.

    Attributes:
        name: of letters, digits and underscores.
        kind: one number a coordinate, an input, a run; a list of numbers; or one a rule.
        names: of the numbers, one for each.
        units: of slides and bends, or of all; empty when unknown.
    """

    name: str
    kind: Kind
    names: list[str]
    units: tuple[str, ...] = ()

    @property
    def title(self) -> str:
        """What it is, in words where there are some."""
        return MEANINGS.get(self.name, self.name)

    def half(self, part: str) -> slice:
        """Where the slides or the bends stand."""
        n = len(self.names) // 2
        return slice(n) if part == "slides" else slice(n, None)

    def unit(self, part: str = "slides") -> str:
        """The unit of slides or bends in brackets, after a space; empty when unknown."""
        return f" [{self.units[0 if part == 'slides' else -1]}]" if self.units else ""

    @property
    def entity(self) -> str:
        """Of a recording, and its structure of lists in which the numbers stand."""
        return "adaptation" if self.name in _SLOW else "signals"

    def fields(self, values: np.ndarray) -> dict[str, np.ndarray]:
        """The numbers, shape (T, k), in the parts that are plotted together, as recorded."""
        if self.name in _SINGLE:
            with np.errstate(over="ignore"):  # of a diverged arm
                values = values.astype(np.float32)
        if self.kind != "coordinates":
            return {self.name: values}
        return {f"{self.name}_{part}": values[:, self.half(part)] for part in ("slides", "bends")}


def channels_of(run: Trajectory, *, disturbed: bool) -> dict[str, Channel]:
    """The channels of a run by name; with the force of the disturbances if there may be one."""
    n = run.q.shape[1] // 2
    coordinates = coordinate_names(n)
    found: dict[str, Channel] = {}
    for name in ("q", "q_d", "error"):
        found[name] = Channel(name, "coordinates", coordinates, _UNITS[name])
    found["tau"] = Channel("tau", "inputs", input_names(n), _UNITS["tau"])
    if disturbed:
        units = _UNITS["disturbance"]
        found["disturbance"] = Channel("disturbance", "coordinates", coordinates, units)
    for signal, array in run.signals.items():
        name = _plain(signal, found)
        units = _UNITS.get(signal, ())
        width = int(np.prod(array.shape[1:]))
        if array.ndim == 3 and array.shape[1] == 2 * n and width:
            names = [f"{c}_{k + 1}" for c in coordinates for k in range(array.shape[2])]
            found[name] = Channel(name, "rules", names, units)
        elif array.shape[1:] == (2 * n,):
            found[name] = Channel(name, "coordinates", coordinates, units)
        elif width == 1:
            found[name] = Channel(name, "scalar", [name], units)
        elif width:
            found[name] = Channel(name, "list", [f"x{k + 1}" for k in range(width)], units)
    return found


def values_of(run: Trajectory, *, disturbed: bool) -> dict[str, np.ndarray]:
    """The numbers of each channel of `channels_of`, each of shape (T, k)."""
    found = {"q": run.q, "q_d": run.q_d, "error": run.error, "tau": run.tau}
    if disturbed:
        found["disturbance"] = run.disturbance
    for signal, array in run.signals.items():
        if int(np.prod(array.shape[1:])):
            found[_plain(signal, found)] = array.reshape(len(run), -1)
    return found


def input_names(modules: int) -> list[str]:
    """Names of the input forces in the order of tau: column 1 and 2 of each module."""
    return [f"column_{a}_{i}" for i in range(1, modules + 1) for a in (1, 2)]


def bounds_of(description: Mapping[str, Any], coordinates: int) -> dict[str, np.ndarray]:
    """What bounds a channel on both sides, as far as the description of the run tells.

    s by the boundary layer phi, the error by what it leads to, phi / lambda; theta and E by the
    bounds that they are projected onto, tau by the saturation among the disturbances. Each has
    shape (2N,).
    """
    gains = description.get("controller", {}).get("gains", {})
    found: dict[str, np.ndarray] = {}

    def known(name: str) -> np.ndarray | None:
        try:
            value = np.broadcast_to(np.asarray(gains.get(name), dtype=float), coordinates)
        except (TypeError, ValueError):
            return None
        return value if np.all(np.isfinite(value)) and np.all(value > 0.0) else None

    phi, lambda_, largest = known("phi"), known("lambda_"), known("E_max")
    if phi is not None:
        found["s"] = phi
        if lambda_ is not None:
            found["error"] = phi / lambda_
    if largest is not None:
        found["E"] = largest
    limits = [
        np.broadcast_to(np.asarray(entry["asked"]["limit"], dtype=float), coordinates)
        for entry in description.get("disturbances", [])
        if entry["name"].startswith("saturation")
    ]
    if limits and np.all(np.isfinite(limits)):
        found["tau"] = np.min(limits, axis=0)
    return found


def bound_lines(name: str, bound: np.ndarray, part: str) -> list[float]:
    """Where lines belong for a channel's bounds, shape (2N,), of slides, of bends, or of all."""
    n = len(bound) // 2
    chosen = {"slides": bound[:n], "bends": bound[n:]}.get(part, bound)
    distinct = sorted(set(chosen.tolist()))
    return distinct if name in _POSITIVE else [*distinct, *(-x for x in distinct)]


def _plain(signal: str, taken: Mapping[str, Any]) -> str:
    """A name of letters, digits and underscores that no other channel has."""
    name = re.sub(r"\W", "_", signal, flags=re.ASCII)
    name = name if name[:1].isalpha() else f"x{name}"
    while name in taken:
        name += "_"
    return name

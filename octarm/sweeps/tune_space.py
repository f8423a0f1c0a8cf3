"""What may be tuned, and how far.

A controller says itself what tuning may turn, `knobs()`: a knob multiplies the hand-set values of
its gains by a factor, one for slides and one for bends where it says so. Factors go by their
logarithms.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from octarm.errors import OctarmError
from octarm.interfaces import Controller, Knob, Tunable


class Unknown(NamedTuple):
    """One coordinate of the search.

    Attributes:
        name: for people.
        knob: that it turns.
        share: 1 for the coordinates of the arm that it is for, 0 for others, shape (2N,).
    """

    name: str
    knob: Knob
    share: np.ndarray


class Space:
    """The gains of one controller, and what is searched.

    A candidate is a vector of d numbers: the logarithms, base 10, of the factors of the unknowns.
    That of the hand-set gains is zero.

    Attributes:
        gains: the hand-set ones, by name.
        knobs: what the controller lets be turned.
        unknowns: what is searched.
        bounds: smallest and largest entry of a candidate, shape (d, 2).
    """

    def __init__(self, controller: Tunable, modules: int) -> None:
        """The space around a controller with its hand-set gains.

        Raises:
            ValueError: if it has no gain that can be tuned.
        """
        self.gains = gains_of(controller)
        slides, every = np.repeat([1.0, 0.0], modules), np.ones(2 * modules)
        self.knobs = controller.knobs()
        self.unknowns: list[Unknown] = []
        for knob in self.knobs:
            parts = {" of slides": slides, " of bends": 1.0 - slides} if knob.apart else {"": every}
            self.unknowns += [Unknown(knob.name + part, knob, x) for part, x in parts.items()]
        if not self.unknowns:
            raise OctarmError(
                f"{type(controller).__name__} has no gain that can be tuned; give one a knob"
            )
        self.bounds = np.log10([(u.knob.low, u.knob.high) for u in self.unknowns])

    def turned(self, candidates: np.ndarray) -> dict[str, np.ndarray]:
        """The gains that are tuned: candidates, shape (n, d), to gains of shape (n, 2N)."""
        table: dict[str, np.ndarray] = {}
        for unknown, logarithms in zip(self.unknowns, candidates.T, strict=True):
            factors = 10.0 ** (unknown.share[:, None] * logarithms)
            for name in unknown.knob.gains:
                table[name] = table.get(name, self.gains[name].reshape(-1, 1)) * factors
        return {name: rounded(columns).T for name, columns in table.items()}

    def fixed(self) -> dict[str, np.ndarray]:
        """The gains that stay as they are, each of the shape of its value in `gains`."""
        tuned = {name for unknown in self.unknowns for name in unknown.knob.gains}
        return {name: gain for name, gain in self.gains.items() if name not in tuned}

    def at_bounds(self, candidate: np.ndarray) -> list[str]:
        """The unknowns that are as small or as large as they may be, within 1 % of the range.

        Args:
            candidate: shape (d,).
        """
        low, high = self.bounds.T
        ends = np.minimum(candidate - low, high - candidate) < 0.01 * (high - low)
        return [u.name for u, at_end in zip(self.unknowns, ends, strict=True) if at_end]


def gains_of(controller: Controller) -> dict[str, np.ndarray]:
    """The gains of a controller that are numbers, by the names under which they are given.

    Arrays have shape (), or that in which the controller holds them, mostly (2N,).
    """
    fields = {f.name: getattr(controller, f.name) for f in dataclasses.fields(controller)}  # pyright: ignore
    return {
        name.rstrip("_"): np.asarray(value)
        for name, value in fields.items()
        if isinstance(value, float | np.ndarray)
    }


def rounded(gains: np.ndarray) -> np.ndarray:
    """Numbers of any shape to four digits: more than anybody can tell apart, and good to read."""
    return np.reshape([float(f"{x:.4g}") for x in gains.ravel().tolist()], gains.shape)

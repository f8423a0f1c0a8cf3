"""Numbers of fuzzy rules over time as a picture: a row for each rule, a column for each instant."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr

from octarm.recordings.channels import Channel

WIDTH, ROW, GAP, LEFT = 720, 7, 6, 108  # of the picture [pixel]
_LOW, _ZERO, _HIGH = (64, 156, 255), (18, 21, 27), (255, 159, 67)


def height(rules: int, coordinates: int) -> int:
    """Height of the picture of that many rules, those of all coordinates together [pixel]."""
    return rules * ROW + (coordinates - 1) * GAP


class HeatMap:
    """Collects at most `2 * WIDTH` instants of a run of any length, for a channel of rules."""

    def __init__(self, channel: Channel, coordinates: int) -> None:
        self._channel, self._coordinates = channel, coordinates
        self._every, self._count = 1, 0
        self._t: list[float] = []
        self._rows: list[np.ndarray] = []

    def add(self, t: np.ndarray, values: np.ndarray) -> None:
        """Instants t, shape (k,) [s], and numbers, shape (k, coordinates * rules)."""
        kept = np.flatnonzero((np.arange(len(t)) + self._count) % self._every == 0)
        self._count += len(t)
        self._t += t[kept].tolist()
        self._rows += list(values[kept])
        while len(self._t) > 2 * WIDTH:
            self._every *= 2
            self._t, self._rows = self._t[::2], self._rows[::2]

    def picture(self) -> np.ndarray:
        """The change since the first instant in colours, shape (height, WIDTH, 3) of uint8.

        Blue is below zero, orange above; the brightest is the largest change of the coordinate.
        """
        changes, largest = self._changes()
        shade = (changes / np.maximum(largest[:, None, None], 1e-300))[..., None]
        toward = np.where(shade > 0.0, _HIGH, _LOW)
        colors = np.array(_ZERO) + np.abs(shade) * (toward - np.array(_ZERO))
        gap = np.full((self._coordinates, GAP, WIDTH, 3), 45.0)
        bands = np.concatenate([np.repeat(colors, ROW, axis=1), gap], axis=1)
        return bands.reshape(-1, WIDTH, 3)[:-GAP].astype(np.uint8)

    def looks(self) -> dict[str, Any]:
        """The picture, and the names of the coordinates and marks on the time axis, by entity."""
        picture, (_, largest) = self.picture(), self._changes()
        low, rules = len(picture), len(self._channel.names) // self._coordinates
        band = (low + GAP) / self._coordinates
        names = [name.rsplit("_", 1)[0] for name in self._channel.names[::rules]]
        labels = [f"{name}: {size:.2g}" for name, size in zip(names, largest, strict=True)]
        places = [(-0.5 * LEFT, band * j + 0.5 * (band - GAP)) for j in range(len(names))]
        marks = np.linspace(self._t[0], self._t[-1], 5)
        labels += [f"{round(t, 1 if marks[-1] > 2.0 else 3):g} s" for t in marks.tolist()]
        places += [(x, low + 12.0) for x in self._across(marks)]
        look: Any = {"radii": 0.01, "colors": [200, 208, 218], "show_labels": True}
        return {"picture": rr.Image(picture), "names": rr.Points2D(places, labels=labels, **look)}

    def cursor(self) -> tuple[np.ndarray, Any]:
        """Instants, shape (k,) [s], and at each the line across all heat maps that shows it."""
        low = height(len(self._channel.names), self._coordinates)
        t = np.array(self._t)[:: -(-len(self._t) // WIDTH)]
        x = self._across(t)
        ends = [np.stack([x, 0 * x + y], axis=-1) for y in (-4.0, low + 4.0)]
        return t, rr.LineStrips2D.columns(strips=np.stack(ends, axis=1).astype(np.float32))

    def _changes(self) -> tuple[np.ndarray, np.ndarray]:
        """Changes since the first instant, shape (coordinates, rules, WIDTH), and the largest."""
        values = np.nan_to_num(np.stack(self._rows))
        index = np.round(np.linspace(0, len(values) - 1, WIDTH)).astype(int)
        changes = (values[index] - values[0]).T.reshape(self._coordinates, -1, WIDTH)
        return changes, np.max(np.abs(changes), axis=(1, 2))

    def _across(self, t: np.ndarray) -> np.ndarray:
        """Where instants [s] stand in the picture [pixel]."""
        return (t - self._t[0]) / max(self._t[-1] - self._t[0], 1e-9) * WIDTH

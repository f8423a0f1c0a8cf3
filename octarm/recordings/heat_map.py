"""Numbers of rules over time as a picture: a row a rule, a column an instant."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr

from octarm.recordings.channels import Channel

WIDTH, ROW, GAP, LEFT = 720, 7, 6, 64  # of the picture [pixel]
_LOW, _ZERO, _HIGH = (64, 156, 255), (18, 21, 27), (255, 159, 67)


def height(rules: int, coordinates: int) -> int:
    """Of the picture [pixel]."""
    return rules * ROW + (coordinates - 1) * GAP


class HeatMap:
    """Collects at most `WIDTH` instants of a run of any length."""

    def __init__(self, channel: Channel, coordinates: int) -> None:
        """For numbers of rules, as many for each coordinate."""
        self._names = [channel.names[k] for k in range(0, len(channel.names),
                       len(channel.names) // coordinates)]  # fmt: skip
        self._title = channel.title
        self._coordinates = coordinates
        self._every, self._count = 1, 0
        self._t: list[float] = []
        self._rows: list[np.ndarray] = []

    def add(self, t: np.ndarray, values: np.ndarray) -> None:
        """Instants t, shape (k,) [s], and numbers, shape (k, coordinates * rules)."""
        chosen = np.flatnonzero((np.arange(len(t)) + self._count) % self._every == 0)
        self._count += len(t)
        self._t += t[chosen].tolist()
        self._rows += list(values[chosen])
        while len(self._t) > 2 * WIDTH:
            self._every *= 2
            self._t, self._rows = self._t[::2], self._rows[::2]

    def picture(self) -> np.ndarray:
        """Red, green and blue, shape (height, WIDTH, 3) of uint8.

        It is the change since the first instant: blue below zero, orange above; the brightest is
        the largest of the coordinate.
        """
        values = np.nan_to_num(np.stack(self._rows))
        values = values - values[0]
        index = np.round(np.linspace(0, len(values) - 1, WIDTH)).astype(int)
        values = values[index].T.reshape(self._coordinates, -1, WIDTH)
        largest = np.max(np.abs(values), axis=(1, 2), keepdims=True)
        shade = values / np.maximum(largest, 1e-300)
        toward = np.where(shade[..., None] > 0.0, _HIGH, _LOW)
        colors = np.array(_ZERO) + np.abs(shade[..., None]) * (toward - np.array(_ZERO))
        bands = np.repeat(colors, ROW, axis=1)
        gap = np.full((self._coordinates, GAP, WIDTH, 3), 45.0)
        whole = np.concatenate([bands, gap], axis=1).reshape(-1, WIDTH, 3)
        return whole[:-GAP].astype(np.uint8)

    def log(self, stream: rr.RecordingStream, entity: str) -> None:
        """Records the picture, names of the coordinates, the time axis and a cursor."""
        picture = self.picture()
        low = len(picture)
        band = (low + GAP) / self._coordinates
        names = [name.rsplit("_", 1)[0] for name in self._names]
        end = self._t[-1]
        ticks = _ticks(self._t[0], end)
        span = max(end - self._t[0], 1e-9)
        places = [[-0.5 * LEFT, band * j + 0.5 * (band - GAP)] for j in range(len(names))]
        places += [[(t - self._t[0]) / span * WIDTH, low + 12.0] for t in ticks]
        labels = [*names, *[f"{t:g} s" for t in ticks]]
        points: Any = rr.Points2D(
            places, labels=labels, radii=0.01, colors=[200, 208, 218], show_labels=True
        )
        stream.log(f"{entity}/picture", rr.Image(picture), static=True)
        stream.log(f"{entity}/names", points, static=True)
        at = np.linspace(self._t[0], end, min(len(self._t), 10 * WIDTH))
        x = (at - self._t[0]) / span * WIDTH
        strips = np.stack([np.stack([x, 0 * x - 4.0], -1), np.stack([x, 0 * x + low + 4.0], -1)], 1)
        stamps = np.round(at * 1e9).astype("timedelta64[ns]")
        columns = rr.LineStrips2D.columns(strips=strips.astype(np.float32))
        stream.log(
            f"{entity}/now", rr.LineStrips2D.from_fields(colors=0xFFFFFFFF, radii=0.8), static=True
        )
        stream.send_columns(f"{entity}/now", [rr.TimeColumn("t", duration=stamps)], columns)


def _ticks(start: float, end: float) -> list[float]:
    """A few round instants between two [s]."""
    span = max(end - start, 1e-9)
    raw = span / 6.0
    size = 10.0 ** np.floor(np.log10(raw))
    step = next(size * k for k in (1.0, 2.0, 5.0, 10.0) if size * k >= raw)
    first = np.ceil(start / step) * step
    return [float(t) for t in np.arange(first, end + 1e-9, step)]

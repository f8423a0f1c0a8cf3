"""Numbers of rules over time as a picture: a row a rule, a column an instant."""

from __future__ import annotations

from typing import Any

import numpy as np
import rerun as rr

from octarm.recordings.channels import Channel

WIDTH, ROW, GAP, LEFT = 720, 7, 6, 108  # of the picture [pixel]
_LOW, _ZERO, _HIGH = (64, 156, 255), (18, 21, 27), (255, 159, 67)


def height(rules: int, coordinates: int) -> int:
    """Of the picture [pixel]."""
    return rules * ROW + (coordinates - 1) * GAP


class HeatMap:
    """Collects at most `WIDTH` instants of a run of any length."""

    def __init__(self, channel: Channel, coordinates: int) -> None:
        """For numbers of rules, as many for each coordinate."""
        self._rules = len(channel.names) // coordinates
        self._names = channel.names[:: self._rules]
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
        values = self._changes()
        shade = values / np.maximum(self._largest()[:, None, None], 1e-300)
        toward = np.where(shade[..., None] > 0.0, _HIGH, _LOW)
        colors = np.array(_ZERO) + np.abs(shade[..., None]) * (toward - np.array(_ZERO))
        bands = np.repeat(colors, ROW, axis=1)
        gap = np.full((self._coordinates, GAP, WIDTH, 3), 45.0)
        whole = np.concatenate([bands, gap], axis=1).reshape(-1, WIDTH, 3)
        return whole[:-GAP].astype(np.uint8)

    def log(self, stream: rr.RecordingStream, entity: str) -> None:
        """Records the picture, names of the coordinates and the time axis."""
        picture = self.picture()
        low = len(picture)
        band = (low + GAP) / self._coordinates
        names = [
            f"{name.rsplit('_', 1)[0]}: {size:.2g}"
            for name, size in zip(self._names, self._largest(), strict=True)
        ]
        ticks = _ticks(self._t[0], self._t[-1])
        places = [[-0.5 * LEFT, band * j + 0.5 * (band - GAP)] for j in range(len(names))]
        places += [[x, low + 12.0] for x in self._across(np.array(ticks))]
        labels = [*names, *[f"{t:g} s" for t in ticks]]
        points: Any = rr.Points2D(
            places, labels=labels, radii=0.01, colors=[200, 208, 218], show_labels=True
        )
        stream.log(f"{entity}/picture", rr.Image(picture), static=True)
        stream.log(f"{entity}/names", points, static=True)

    def log_cursor(self, stream: rr.RecordingStream, entity: str) -> None:
        """Records the line that shows the time; it serves all heat maps of a run."""
        low = height(len(self._names) * self._rules, self._coordinates)
        at = np.array(self._t)[:: -(-len(self._t) // WIDTH)]
        x = self._across(at)
        strips = np.stack([np.stack([x, 0 * x - 4.0], -1), np.stack([x, 0 * x + low + 4.0], -1)], 1)
        stamps = np.round(at * 1e9).astype("timedelta64[ns]")
        look = rr.LineStrips2D.from_fields(colors=0xFFFFFFFF, radii=0.8)
        stream.log(entity, look, static=True)
        columns = rr.LineStrips2D.columns(strips=strips.astype(np.float32))
        stream.send_columns(entity, [rr.TimeColumn("t", duration=stamps)], columns)

    def _changes(self) -> np.ndarray:
        """Since the first instant, shape (coordinates, rules, WIDTH)."""
        values = np.nan_to_num(np.stack(self._rows))
        index = np.round(np.linspace(0, len(values) - 1, WIDTH)).astype(int)
        return (values[index] - values[0]).T.reshape(self._coordinates, -1, WIDTH)

    def _largest(self) -> np.ndarray:
        """The largest change of each coordinate, shape (coordinates,)."""
        return np.max(np.abs(self._changes()), axis=(1, 2))

    def _across(self, t: np.ndarray) -> np.ndarray:
        """Where instants [s] stand in the picture [pixel]."""
        return (t - self._t[0]) / max(self._t[-1] - self._t[0], 1e-9) * WIDTH


def _ticks(start: float, end: float) -> list[float]:
    """A few round instants between two [s]."""
    span = max(end - start, 1e-9)
    raw = span / 6.0
    size = 10.0 ** np.floor(np.log10(raw))
    step = next(size * k for k in (1.0, 2.0, 5.0, 10.0) if size * k >= raw)
    first = np.ceil(start / step) * step
    return [float(t) for t in np.arange(first, end + 1e-9, step)]

"""The immutable record of one run, and its twin on disk."""

from __future__ import annotations

import dataclasses
import os
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import Any, Literal, NamedTuple

import numpy as np

from octarm.errors import OctarmError
from octarm.files import whole_file
from octarm.interfaces import Rows
from octarm.simulation.recorder import RESERVED

BLOCK = 5000  # rows: fewer cost space in a recording, more cost memory and what a crash loses
_ARRAYS = ("t", "q", "v", "q_d", "v_d", "tau", "force", "disturbance")
LAYER = "layer"


class Ending(NamedTuple):
    """What is known of a run beside its rows; see the fields of these names in `Trajectory`."""

    status: Literal["ok", "diverged", "interrupted"] = "ok"
    message: str = ""
    digest: str = ""
    layer: np.ndarray | None = None

    def texts(self) -> dict[str, str]:
        """All but the layer, by name."""
        return {"status": self.status, "message": self.message, "digest": self.digest}

    def arrays(self) -> dict[str, np.ndarray]:
        """All that there is as arrays by name, in the order of the file."""
        layer = {} if self.layer is None else {LAYER: np.asarray(self.layer, dtype=np.float64)}
        return layer | {name: np.array(text) for name, text in self.texts().items()}

    @classmethod
    def taken_from(cls, arrays: dict[str, np.ndarray]) -> Ending:
        """The inverse of `arrays`; what it takes is removed from the dictionary.

        Raises:
            KeyError: if a text is missing.
        """
        layer = arrays.pop(LAYER, None)
        texts: list[Any] = [str(arrays.pop(name)) for name in cls().texts()]
        return cls(*texts, layer)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Trajectory:
    """What happened at each control instant of one run; row k is time t[k].

    All arrays are float64 and read-only; those that can be written to are copied. T is the number
    of control periods that were begun.

    Attributes:
        t: time, shape (T,) [s].
        q: true generalised coordinates, shape (T, 2N) [m], [rad].
        v: true generalised velocities, shape (T, 2N) [m/s], [rad/s].
        q_d: desired coordinates, shape (T, 2N) [m], [rad].
        v_d: desired velocities, shape (T, 2N) [m/s], [rad/s].
        tau: input forces held during the period that begins at t, shape (T, 2N) [N].
        force: generalised force Q the controller asked for, shape (T, 2N) [N], [N m].
        disturbance: generalised force that disturbances added, shape (T, 2N) [N], [N m].
        signals: the controller's own quantities by name, each of shape (T, k); and `q_measured` and
            `v_measured`, the readings, when sensors act.
        layer: half width of the boundary layer around s = 0, shape (2N,) [m/s], [rad/s]; None when
            the controller has none.
        status: `ok`, or `diverged` or `interrupted` when the run ended before its time.
        message: one sentence on how such a run ended; empty otherwise.
        digest: SHA-256 over MuJoCo's integration state at every control instant.

    Raises:
        OctarmError: if lengths differ, or a signal has the name of another field.
    """

    t: np.ndarray
    q: np.ndarray
    v: np.ndarray
    q_d: np.ndarray
    v_d: np.ndarray
    tau: np.ndarray
    force: np.ndarray
    disturbance: np.ndarray
    signals: Mapping[str, np.ndarray]
    layer: np.ndarray | None = None
    status: Literal["ok", "diverged", "interrupted"] = "ok"
    message: str = ""
    digest: str = ""

    def __post_init__(self) -> None:
        for name in self.signals:
            if name in (*_ARRAYS, *RESERVED):
                raise OctarmError(f"a signal cannot be called {name!r}: the trajectory has that")
        for name, array in self.arrays():
            if len(array) != len(self.t):
                raise OctarmError(f"{name} has {len(array)} rows; t has {len(self.t)}")
        for name in _ARRAYS:
            object.__setattr__(self, name, _read_only(getattr(self, name)))
        signals = {name: _read_only(array) for name, array in self.signals.items()}
        object.__setattr__(self, "signals", MappingProxyType(signals))
        if self.layer is not None:
            layer = np.broadcast_to(np.asarray(self.layer, dtype=np.float64), self.q.shape[1:])
            object.__setattr__(self, "layer", _read_only(layer.copy()))

    def __len__(self) -> int:
        """Number of rows T."""
        return len(self.t)

    @property
    def error(self) -> np.ndarray:
        """Tracking error e = q - q_d, shape (T, 2N) [m], [rad]."""
        return self.q - self.q_d

    @property
    def ending(self) -> Ending:
        """What is known beside the rows."""
        return Ending(self.status, self.message, self.digest, self.layer)

    def arrays(self) -> Iterator[tuple[str, np.ndarray]]:
        """Name and array, shape (T, ...), of what has a row an instant, signals included."""
        for name in _ARRAYS:
            yield name, getattr(self, name)
        yield from self.signals.items()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the twin `.npz`, whole or not at all; equal trajectories give equal bytes."""
        arrays = dict(self.arrays()) | self.ending.arrays()
        with whole_file(path) as part, open(part, "wb") as file:
            np.savez(file, allow_pickle=False, **arrays)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Trajectory:
        """Reads what `save` wrote.

        Raises:
            OctarmError: if the file is not a trajectory.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = dict(file)
            for array in arrays.values():
                array.setflags(write=False)
            ending = Ending.taken_from(arrays)
            return cls.from_rows(arrays, ending)
        except (KeyError, ValueError, zipfile.BadZipFile) as error:
            raise OctarmError(f"{path} is not a trajectory file ({error})") from None

    @classmethod
    def from_rows(cls, rows: Rows, ending: Ending) -> Trajectory:
        """A trajectory of rows, see `octarm.interfaces.Rows`.

        Raises:
            KeyError: if a field is missing that every run has.
        """
        fields = {name: rows[name] for name in _ARRAYS}
        signals = {name: array for name, array in rows.items() if name not in fields}
        return cls(**fields, signals=signals, **ending._asdict())


def joined(blocks: Sequence[Rows], ending: Ending) -> Trajectory:
    """A trajectory of consecutive blocks of rows, of which there is at least one."""
    arrays = {name: np.concatenate([rows[name] for rows in blocks]) for name in blocks[0]}
    for array in arrays.values():
        array.setflags(write=False)  # so that it is not copied once more
    return Trajectory.from_rows(arrays, ending)


def _read_only(array: np.ndarray) -> np.ndarray:
    """A copy, unless it is read-only already: what is mapped from a file is not to be read."""
    if array.dtype == np.float64 and not array.flags.writeable:
        return array
    array = np.array(array, dtype=np.float64)
    array.setflags(write=False)
    return array

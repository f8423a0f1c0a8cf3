"""The immutable record of one run, and its twin on disk."""

from __future__ import annotations

import dataclasses
import os
import zipfile
from collections.abc import Iterator, Mapping
from types import MappingProxyType
from typing import Literal

import numpy as np

from octarm.errors import OctarmError
from octarm.files import whole_file

_ARRAYS = ("t", "q", "v", "q_d", "v_d", "tau", "force", "disturbance")
TEXTS = ("status", "message", "digest")


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
        signals: the controller's own quantities by name, each of shape (T, k).
        layer: half width phi of the controller's boundary layer, shape (2N,) [m/s], [rad/s]; None
            where there is none.
        status: `ok`, or `diverged` or `interrupted` when the run ended before its time.
        message: one sentence on how such a run ended; empty otherwise.
        digest: SHA-256 over MuJoCo's integration state at every control instant.

    Raises:
        ValueError: if lengths differ, or a signal has the name of an array above.
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
        taken = [name for name in self.signals if name in (*_ARRAYS, *TEXTS)]
        if taken:
            raise OctarmError(f"a signal cannot be called {taken[0]!r}: the trajectory has that")
        for name, array in self.arrays():
            if len(array) != len(self.t):
                raise OctarmError(f"{name} has {len(array)} rows; t has {len(self.t)}")
        for name in _ARRAYS:
            object.__setattr__(self, name, _read_only(getattr(self, name)))
        signals = {name: _read_only(array) for name, array in self.signals.items()}
        object.__setattr__(self, "signals", MappingProxyType(signals))

    def __len__(self) -> int:
        """Number of rows T."""
        return len(self.t)

    @property
    def error(self) -> np.ndarray:
        """Tracking error e = q - q_d, shape (T, 2N) [m], [rad]."""
        return self.q - self.q_d

    def arrays(self) -> Iterator[tuple[str, np.ndarray]]:
        """Name and array, shape (T, ...), of what has a row an instant, signals included."""
        for name in _ARRAYS:
            yield name, getattr(self, name)
        yield from self.signals.items()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the twin `.npz`, whole or not at all; equal trajectories give equal bytes."""
        texts = {name: np.array(getattr(self, name)) for name in TEXTS}
        with whole_file(path) as part, open(part, "wb") as file:
            layer = {} if self.layer is None else {"layer": self.layer}
            np.savez(file, allow_pickle=False, **dict(self.arrays()), **layer, **texts)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Trajectory:
        """Reads what `save` wrote.

        Raises:
            ValueError: if the file is not a trajectory.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                arrays = dict(file)
            texts = {name: str(arrays.pop(name)) for name in TEXTS}
            for array in arrays.values():
                array.setflags(write=False)
            return cls.from_arrays(arrays, texts)
        except (KeyError, ValueError, zipfile.BadZipFile) as error:
            raise OctarmError(f"{path} is not a trajectory file ({error})") from None

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray], texts: Mapping[str, str]) -> Trajectory:
        """A trajectory of what `arrays` yields by name, each of shape (T, ...), and its texts.

        Raises:
            KeyError: if something is missing.
        """
        fixed = {name: arrays[name] for name in _ARRAYS}
        layer = arrays.get("layer")
        known = (*fixed, "layer")
        signals = {name: array for name, array in arrays.items() if name not in known}
        ended = {name: texts[name] for name in TEXTS}
        return cls(**fixed, **ended, signals=signals, layer=layer)  # pyright: ignore[reportArgumentType]


def _read_only(array: np.ndarray) -> np.ndarray:
    """A copy, unless it is read-only already: what is mapped from a file is not to be read."""
    if array.dtype == np.float64 and not array.flags.writeable:
        return array
    array = np.array(array, dtype=np.float64)
    array.setflags(write=False)
    return array

"""The immutable record of one run, and its twin on disk."""

from __future__ import annotations

import contextlib
import dataclasses
import math
import os
import warnings
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from types import MappingProxyType
from typing import IO, Any, Literal, NamedTuple, get_args

import numpy as np
from numpy.lib import format as npy

from octarm.arrays import planar_coordinates
from octarm.errors import FileError, OctarmError, quoted
from octarm.files import whole_file
from octarm.html import Cell, Table, notebook_cell, small_plot
from octarm.interfaces import Rows

BLOCK = 5000  # rows: fewer cost space in a recording, more cost memory and what a crash loses
NUMBER = np.dtype("<f8")  # of all arrays in a file but the texts
_WORD = "<U"  # how the kinds of texts begin
_ARRAYS = ("t", "q", "v", "q_d", "v_d", "tau", "force", "disturbance")

Status = Literal["ok", "diverged", "interrupted"]


class Ending(NamedTuple):
    """What a run holds in addition to its rows; see the same fields of `Trajectory`.

    Attributes:
        layer: half width of the boundary layer, shape (2N,) [m/s], [rad/s]; None if there is none.
        status: how it ended.
        message: one sentence on that.
        digest: of all states.
    """

    layer: np.ndarray | None = None
    status: Status = "ok"
    message: str = ""
    digest: str = ""

    def arrays(self) -> dict[str, np.ndarray]:
        """What there is, by name, as it is saved: `layer`, shape (2N,), and texts, shape ()."""
        return {name: np.asarray(x) for name, x in self._asdict().items() if x is not None}


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
        signals: the controller's own quantities by name, each of shape (T, k); `q_measured` and
            `v_measured`, the readings, when sensors act; and for the m physics steps of each
            control period `received`, the input forces that reached the arm in them, shape
            (T, m, 2N) [N], and if m > 1 `q_steps` and `q_d_steps`, q and q_d when they began.
        layer: half width of the boundary layer around s = 0, shape (2N,) [m/s], [rad/s]; None when
            the controller has none.
        status: `ok`, or `diverged` or `interrupted` when the run ended before its time.
        message: one sentence on how such a run ended; empty otherwise.
        digest: SHA-256 over MuJoCo's integration state at every control instant.
        episode: which one of the environment's episodes it was, from 0, see `octarm.load`; None
            when it was read from a file.

    Raises:
        OctarmError: if lengths or shapes differ, or a signal has the name of another field.
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
    status: Status = "ok"
    message: str = ""
    digest: str = ""
    episode: int | None = None

    def __post_init__(self) -> None:
        for name in self.signals:
            if name in (*_ARRAYS, *Ending._fields):
                raise OctarmError(
                    f"a signal cannot be called {quoted(name)}: the trajectory has that"
                )
        if np.ndim(self.t) != 1 or np.ndim(self.q) != 2 or self.q.shape[1] % 2:
            shapes = f"{np.shape(self.t)} and {np.shape(self.q)}"
            raise OctarmError(f"t and q have the shapes {shapes}; they must be (T,) and (T, 2N)")
        for name, array in self.arrays():
            if len(array) != len(self.t):
                raise OctarmError(f"{name} has {len(array)} rows; t has {len(self.t)}")
            if name in _ARRAYS[1:] and array.shape != self.q.shape:
                raise OctarmError(f"{name} has the shape {array.shape}; q has {self.q.shape}")
        for name in _ARRAYS:
            object.__setattr__(self, name, _read_only(getattr(self, name)))
        signals = {name: _read_only(array) for name, array in self.signals.items()}
        object.__setattr__(self, "signals", MappingProxyType(signals))
        if self.layer is not None:
            shape, needed = np.shape(self.layer), self.q.shape[1:]
            if shape not in ((), needed):
                raise OctarmError(f"layer has the shape {shape}; it must be {needed}")
            layer = np.broadcast_to(self.layer, needed)
            object.__setattr__(self, "layer", _read_only(np.array(layer)))

    def __len__(self) -> int:
        """Number of rows T."""
        return len(self.t)

    @property
    def error(self) -> np.ndarray:
        """Tracking error e = q - q_d, shape (T, 2N) [m], [rad]."""
        return self.q - self.q_d

    def _repr_html_(self) -> str:
        """What a notebook shows of it."""
        end = f"0 to {self.t[-1]:.6g} s" if len(self) else "no time"
        title = f"Trajectory: {len(self)} control instants, {end}, {self.status}"
        return notebook_cell(title, [self.message] if self.message else [], self.table())

    @np.errstate(all="ignore")  # a diverged arm may hold anything
    def table(self) -> Table:
        """How each coordinate is tracked, for a page or a notebook."""
        names, units, *_ = planar_coordinates(self.q.shape[1] // 2)
        over_time = Cell("over time", ["wide: desired"], "left")
        head = [Cell("", kind="left"), Cell("rms error"), Cell("largest error"), over_time]
        rows: list[list[Cell]] = []
        for j, (name, unit) in enumerate(zip(names, units, strict=True)):
            error = self.error[:, j] if len(self) else np.full(1, np.nan)
            sizes = (float(np.sqrt(np.mean(error**2))), float(np.abs(error).max()))
            numbers = [Cell(f"{1e3 * x:.3g} m{unit}") for x in sizes]
            plot = small_plot(self.q[:, j], self.q_d[:, j])
            rows.append([Cell(name, kind="left"), *numbers, Cell(plot, kind="left")])
        return Table(head, rows)

    def arrays(self) -> Iterator[tuple[str, np.ndarray]]:
        """Name and array, shape (T, ...), of what has a row an instant, signals included."""
        for name in _ARRAYS:
            yield name, getattr(self, name)
        yield from self.signals.items()

    def saved(self) -> dict[str, np.ndarray]:
        """All that `save` writes, by name: rows of shape (T, ...), and the ending."""
        ending = Ending(self.layer, self.status, self.message, self.digest)
        return {**dict(self.arrays()), **ending.arrays()}

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the twin `.npz`, whole or not at all; equal trajectories give equal bytes."""
        with whole_file(path) as part, open(part, "wb") as file:
            np.savez(file, allow_pickle=False, **self.saved())

    @classmethod
    def load(cls, path: str | os.PathLike[str], *, mapped: bool = False) -> Trajectory:
        """Reads what `save` wrote.

        Args:
            path: of the file.
            mapped: whether arrays are read from disk as far as they are looked at.

        Raises:
            OctarmError: if the file is not a trajectory, or cannot be read.
        """
        try:
            return cls.from_arrays(read_arrays(path, mapped=mapped))
        except MemoryError:
            raise
        except Exception as error:  # damaged bytes raise errors of any kind
            if isinstance(error, OSError) and error.strerror:
                raise FileError(f"{path} cannot be read: {error.strerror}") from None
            raise unreadable(path, error) from None

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, np.ndarray]) -> Trajectory:
        """A trajectory of all that `save` writes, by name: rows of shape (T, ...), and the ending.

        Raises OctarmError if something is missing, is no number or no text, or has a wrong shape.
        """
        if missing := {*_ARRAYS, *Ending._fields[1:]} - arrays.keys():
            raise OctarmError(f"there is no array {' and no '.join(sorted(missing))}")
        for name, array in arrays.items():
            text = name in Ending._fields[1:]
            if (array.dtype.kind == "U", array.ndim == 0) != (text, text):
                raise OctarmError(
                    f"the array {name} is of the wrong kind, {array.dtype} of shape {array.shape}"
                )
        texts: dict[str, Any] = {name: str(arrays[name]) for name in Ending._fields[1:]}
        if texts["status"] not in get_args(Status):
            known = ", ".join(get_args(Status))
            raise OctarmError(f"the status is {quoted(texts['status'])}; it must be {known}")
        t = arrays["t"]
        if not (np.isfinite(t).all() and np.all(t[1:] > t[:-1])):
            raise OctarmError("the times do not rise")
        rows = {name: array for name, array in arrays.items() if name not in Ending._fields}
        return cls.from_rows(rows, Ending(arrays.get("layer"), **texts))

    @classmethod
    def from_rows(cls, rows: Rows, ending: Ending) -> Trajectory:
        """A trajectory of rows, see `octarm.interfaces.Rows`.

        Raises KeyError if a field is missing that every run has.
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


def read_arrays(path: str | os.PathLike[str], *, mapped: bool = False) -> dict[str, np.ndarray]:
    """The arrays of a file by name, read-only: float64 of any shape, and texts of shape ().

    Mapped numbers stay on disk until they are looked at. Raises OSError if the file cannot be read,
    ValueError if it is damaged, or holds something else; NumPy and zipfile raise errors of further
    kinds on damaged bytes.
    """
    arrays: dict[str, np.ndarray] = {}
    whole: np.ndarray | None = None
    with (
        open(path, "rb") as file,
        zipfile.ZipFile(file) as content,
        warnings.catch_warnings(action="error"),
    ):
        if (damaged := content.testzip()) is not None:
            raise ValueError(f"{damaged} is damaged")
        for member in content.infolist():
            name = member.filename.removesuffix(".npy")
            if name == member.filename or name in arrays:
                raise ValueError(f"{name} is there twice, or no array")
            with content.open(member) as stream:
                begin = file.tell()  # of the member, if it is not compressed
                shape, order, kind = _header(name, stream, member.file_size)
                if mapped and not member.compress_type and kind == NUMBER and math.prod(shape):
                    if whole is None:  # one mapping for all: each one keeps a file open
                        whole = np.asarray(np.memmap(path, np.uint8, "r"))
                    place = begin + stream.tell()
                    values = whole[place : place + kind.itemsize * math.prod(shape)].view(kind)
                    array = values.reshape(shape, order=order)
                else:
                    array = np.frombuffer(stream.read(), kind).reshape(shape, order=order)
            arrays[name] = array
    return arrays


def _header(
    name: str, stream: IO[bytes], size: int
) -> tuple[tuple[int, ...], Literal["C", "F"], np.dtype[Any]]:
    """Shape, order and kind of the array in a member of so many bytes, which follows."""
    if npy.read_magic(stream) != (1, 0):
        raise ValueError(f"{name} is of another version")
    shape, fortran, kind = npy.read_array_header_1_0(stream)
    if not (kind.str == NUMBER.str or (kind.str.startswith(_WORD) and shape == ())):
        raise ValueError(f"{name} holds {kind.str}; it must hold {NUMBER.str}")
    if min(shape, default=0) < 0 or math.prod(shape) * kind.itemsize != size - stream.tell():
        raise ValueError(f"{name} holds another number of values than it says")
    return shape, "F" if fortran else "C", kind


def unreadable(path: str | os.PathLike[str], error: Exception) -> OctarmError:
    """What is said of a file whose arrays cannot be read: cut off, or of another kind."""
    if isinstance(error, zipfile.BadZipFile):
        with contextlib.suppress(OSError), open(path, "rb") as file:
            if file.read(2) == b"PK":  # as every zip file begins
                return OctarmError(f"{path} is damaged ({error})")
    return OctarmError(f"{path} is not a trajectory file ({error})")

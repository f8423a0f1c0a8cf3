"""Motions from files of samples, CSV or NPZ, with a spline through them.

- CSV: a line with the names of the columns, `t` [s] and coordinates such as `theta1` [m], [rad], in
  any order; coordinates without a column rest. Without such a line, t and all of q in its order.
- NPZ: an array `t`, and either `q` of shape (K, 2N), as `run.npz` has it, or one of shape (K,) for
  each coordinate that moves.
"""

from __future__ import annotations

import csv
import dataclasses
import io
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated

import numpy as np

from octarm.arrays import coordinate_names
from octarm.errors import OctarmError, closest, quoted
from octarm.fields import FileName, Words
from octarm.files import read_bytes
from octarm.interfaces import Motion
from octarm.references.motions import REAL, Spline
from octarm.references.named import Hanging, NamedReference


@dataclasses.dataclass(frozen=True, kw_only=True)
class Samples(NamedReference):
    """Samples in a file, CSV or NPZ: `t` [s] and coordinates [m], [rad]; a spline through them."""

    path: Annotated[str, FileName()]
    spline: Annotated[str, Words(alone=("quintic", "cubic"))] = "quintic"

    def start(self, arm: Hanging) -> Motion:
        file = Path(self.path).expanduser()
        columns = _columns(file, arm.modules)
        degree = {"quintic": 5, "cubic": 3}[self.spline]
        try:
            times, points = _motion(columns, arm.rest)
            spline = Spline(times=times, points=points, degree=degree)
        except OctarmError as error:
            raise OctarmError(f"{file} holds no motion of this arm: {error}") from None
        return spline.__call__  # run.json has the SHA-256 of the file instead of all samples


def samples_end(file: Path) -> float:
    """When the samples of a file end, one interval after the last one [s]; they are one motion."""
    times = _columns(file)["t"]
    return float(2.0 * times[-1] - times[-2])


def _columns(file: Path, modules: int | None = None) -> dict[str, np.ndarray]:
    return _arrays(file) if file.suffix == ".npz" else _table(file, modules)


def _motion(columns: Mapping[str, np.ndarray], rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Times, shape (K,), and coordinates, shape (K, 2N), from the columns of a file."""
    names = coordinate_names(rest.shape[-1] // 2)
    if rest.ndim > 1:
        raise OctarmError("it is for one arm, or for several that hang alike")
    if "t" not in columns:
        raise OctarmError(f"it has no column t{closest('t', columns)}")
    times = columns["t"]
    points = np.tile(rest, (times.size, 1))
    if "q" in columns:
        if columns["q"].shape != points.shape:
            raise OctarmError(f"q has shape {columns['q'].shape}; it must be {points.shape}")
        return times, columns["q"]
    for name, column in columns.items():
        if name not in ("t", *names):
            raise OctarmError(f"it has a column {quoted(name)}{closest(name, ('t', *names))}")
        if column.shape != (times.size,):
            raise OctarmError(f"{name} has shape {column.shape}; it must be {(times.size,)}")
        if name != "t":
            points[:, names.index(name)] = column
    return times, points


def _arrays(file: Path) -> dict[str, np.ndarray]:
    """The arrays t and q of an NPZ file, or all of them."""
    try:
        with np.load(io.BytesIO(read_bytes(file)), allow_pickle=False) as arrays:
            names = arrays.files
            if {"t", "q"} <= set(names):
                names = ["t", "q"]
            columns = {name: arrays[name] for name in names}
    except (ValueError, EOFError, zipfile.BadZipFile, AttributeError):
        raise OctarmError(f"{file} is no NPZ file of arrays of numbers") from None
    for name, column in columns.items():
        if column.dtype.kind not in REAL:
            raise OctarmError(f"{file}: {name} must be an array of real numbers")
    return columns


def _table(file: Path, modules: int | None) -> dict[str, np.ndarray]:
    """The columns of a CSV file by name, shapes (K,), those without a name for any arm if None."""
    text = read_bytes(file).decode("utf-8-sig", "replace")
    lines = csv.reader(io.StringIO(text))
    try:
        rows = [(lines.line_num, row) for row in lines if row and not row[0].startswith("#")]
    except csv.Error as error:
        raise OctarmError(f"{file}, line {lines.line_num}: {error}") from None
    if not rows:
        raise OctarmError(f"{file} holds no samples")
    names = [word.strip() for word in rows[0][1]]
    if _is_number(names[0]):
        names = ["t", *coordinate_names(len(names) // 2 if modules is None else modules)]
    else:
        rows = rows[1:]
    if len(set(names)) < len(names):
        raise OctarmError(f"{file} has two columns of the same name")
    table = np.array([_numbers(file, line, row, names) for line, row in rows])
    return dict(zip(names, table.reshape(-1, len(names)).T, strict=True))


def _numbers(file: Path, line: int, row: Sequence[str], names: Sequence[str]) -> list[float]:
    if len(row) != len(names):
        raise OctarmError(
            f"{file}, line {line} has {len(row)} values; it must have {len(names)}: "
            f"{', '.join(names)}"
        )
    for word in row:
        if not _is_number(word):
            raise OctarmError(f"{file}, line {line} has {quoted(word)}; it must be a number")
    return [float(word) for word in row]


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True

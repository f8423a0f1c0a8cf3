"""The arrays of a run on disk: appended block by block while it goes on, and mapped afterwards.

A block is one structured number in NumPy's own format, whose fields are the arrays of the block. So
memory holds one block, however long the run is, and blocks can be read although the process was
killed.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import zipfile
from collections.abc import Generator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy

from octarm.errors import FileError, OctarmError
from octarm.files import whole_file
from octarm.interfaces import Rows
from octarm.simulation.trajectory import BLOCK as BLOCK
from octarm.simulation.trajectory import NUMBER, Ending, Trajectory, joined

_LONGEST_HEADER = 10_000_000  # [byte]


class Archive:
    """The rows of a run on their way into a `.npz`: `add` blocks in their order, then `save`.

    Used with `with`: the file of blocks is gone afterwards. If the process is killed it stays, and
    `read_blocks` reads it.
    """

    def __init__(self, path: str | os.PathLike[str], *, rows: int) -> None:
        """An archive in a file of blocks, whose folder must exist, with room for so many rows.

        Raises FileError if it cannot be written.
        """
        self._path, self._expected, self._count = Path(path), rows, 0
        with self._failures():
            self._file = open(self._path, "w+b")
        self._blocks: list[tuple[int, np.dtype[Any]]] = []  # where each begins, and its fields

    def __enter__(self) -> Archive:
        """Nothing more: the file is open."""
        return self

    def __exit__(self, *_: object) -> None:
        """Removes the file."""
        with contextlib.suppress(OSError):  # of a full disk; the user knows already
            self._file.close()
        self._path.unlink(missing_ok=True)

    def __len__(self) -> int:
        """Number of rows so far."""
        return self._count

    def add(self, rows: Rows, layer: np.ndarray | None = None) -> None:
        """Appends a block of rows; they are with the operating system afterwards.

        The half width of the boundary layer has shape (2N,) [m/s], [rad/s], if there is one. Raises
        FileError if the file cannot be written, or there is no room for all that is expected.
        """
        arrays = dict(rows) if layer is None else {**rows, "layer": layer}
        block = np.empty((), [(name, NUMBER, np.shape(x)) for name, x in arrays.items()])
        for name, array in arrays.items():
            block[name] = array
        with self._failures():
            if not self._count:
                self._check_room(block.nbytes / len(rows["t"]))
            npy.write_array(self._file, block, version=(3, 0), allow_pickle=False)
            self._file.flush()
            self._blocks.append((self._file.tell() - block.nbytes, block.dtype))
        self._count += len(rows["t"])

    def save(self, path: str | os.PathLike[str], ending: Ending) -> None:
        """Writes the `.npz`, whole or not at all, the same bytes as `Trajectory.save` would.

        Raises FileError if it cannot be written.
        """
        with whole_file(path) as part, zipfile.ZipFile(part, "w") as file:
            for name, (first, *_) in (self._blocks[0][1].fields or {}).items():
                if name in Ending._fields:
                    continue
                with file.open(f"{name}.npy", "w", force_zip64=True) as member:
                    shape = (len(self), *first.shape[1:])
                    header = {"descr": NUMBER.str, "fortran_order": False, "shape": shape}
                    npy.write_array_header_1_0(member, header)
                    for begin, fields in self._blocks:
                        kind, place = (fields.fields or {})[name][:2]
                        self._file.seek(begin + place)
                        member.write(self._file.read(kind.itemsize))
            for name, array in ending.arrays().items():
                with file.open(f"{name}.npy", "w", force_zip64=True) as member:
                    npy.write_array(member, array, allow_pickle=False)

    def _check_room(self, row: float) -> None:
        """Raises FileError unless all rows of so many bytes fit twice: as blocks, and as arrays."""
        needed, free = 2 * row * self._expected, shutil.disk_usage(self._path.parent).free
        if needed > free:
            sizes = f"{1e-9 * needed:.3g} GB on disk, of which {1e-9 * free:.3g} GB are free"
            raise FileError(f"so many rows take {sizes}")

    @contextlib.contextmanager
    def _failures(self) -> Generator[None]:
        try:
            yield
        except OSError as error:
            reason = error.strerror or error
            raise FileError(f"{self._path} cannot be written: {reason}") from error


def read_blocks(path: str | os.PathLike[str]) -> Trajectory:
    """What an `Archive` had added when its process was killed; the status is `interrupted`.

    Raises OctarmError if there is no whole block.
    """
    blocks: list[dict[str, np.ndarray]] = []
    # At the end, or amid a block; what is no block raises errors of any kind.
    with open(path, "rb") as file, contextlib.suppress(Exception):
        while True:
            block = npy.read_array(file, allow_pickle=False, max_header_size=_LONGEST_HEADER)
            fields = {name: block[name] for name in block.dtype.names or ()}
            if not all(array.dtype == NUMBER for array in fields.values()):
                break
            blocks.append(fields)
    layers = [block.pop("layer", None) for block in blocks]
    if not blocks or "t" not in blocks[0] or not blocks[0]["t"].size:
        raise OctarmError(f"{path} holds no rows")
    try:
        end = f"killed after t = {blocks[-1]['t'][-1]:.6g} s"
        return joined(blocks, Ending(layers[0], "interrupted", end))
    except (IndexError, KeyError, TypeError, ValueError) as error:
        raise OctarmError(f"{path} holds other arrays than those of a run ({error})") from None

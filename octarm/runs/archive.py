"""The arrays of a run on disk: appended block by block while it goes on, and mapped afterwards.

Memory holds one block, however long the run is. What was added can be read although the process
was killed.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import math
import os
import shutil
import struct
import zipfile
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import IO, NamedTuple

import numpy as np

from octarm.errors import OctarmError
from octarm.files import whole_file
from octarm.simulation.trajectory import TEXTS, Trajectory

BLOCK = 5000  # rows: fewer cost space in a recording, more cost memory and what a crash loses
_NUMBER = np.dtype("<f8")
_LOCAL_HEADER = 30  # bytes of a zip member before its name, the last four of them two lengths


class _Layout(NamedTuple):
    """Where the numbers stand: a line of JSON, then blocks, each array after array.

    Attributes:
        start: where the first block begins [byte].
        rows: of a block.
        shapes: of a row of each array, by name.
    """

    start: int
    rows: int
    shapes: dict[str, tuple[int, ...]]

    @property
    def block(self) -> int:
        """Size of a block [byte]."""
        return sum(self.size(name) for name in self.shapes)

    def size(self, name: str) -> int:
        """Of an array in a block [byte]."""
        return self.rows * self.row(name)

    def row(self, name: str) -> int:
        """Size of a row of an array [byte]."""
        return _NUMBER.itemsize * math.prod(self.shapes[name])

    def place(self, name: str) -> int:
        """Where an array begins in a block [byte]."""
        before = itertools.takewhile(lambda other: other != name, self.shapes)
        return sum(map(self.size, before))


class Ending(NamedTuple):
    """How a run ended; see the fields of these names in `Trajectory`."""

    status: str
    message: str
    digest: str


class Archive:
    """The rows of a run on their way into a `.npz`: `add` blocks in their order, then `save`.

    Used with `with`: the file of blocks is gone afterwards. If the process is killed it stays, and
    `read_blocks` reads it.

    Attributes:
        ending: how the run ended, as far as it is known; it is saved with the rows.
    """

    def __init__(self, path: str | os.PathLike[str], *, rows: int, block: int = BLOCK) -> None:
        """An archive that is empty.

        Args:
            path: of the file of blocks; its folder must exist.
            rows: number that is expected, for which there must be room.
            block: number of rows of every block but the last one, which may have fewer.
        """
        self.ending = Ending("interrupted", "", "")
        self._path, self._expected, self._count = Path(path), rows, 0
        self._block = block = min(block, rows)
        self._file: IO[bytes] | None = None
        self._layout = _Layout(0, block, {})
        self._layer: np.ndarray | None = None

    def __enter__(self) -> Archive:
        """Makes the file; raises OSError if it cannot be written."""
        with self._failures():
            self._file = open(self._path, "w+b")
        return self

    def __exit__(self, *_: object) -> None:
        """Removes the file."""
        if self._file is not None:
            with contextlib.suppress(OSError):  # of a full disk; it has been said
                self._file.close()
        self._path.unlink(missing_ok=True)

    def __len__(self) -> int:
        """Number of rows so far."""
        return self._count

    def add(self, rows: Trajectory) -> None:
        """Appends rows; they are with the operating system afterwards.

        Raises:
            ValueError: if there are more than a block has, or the one before was not full.
            OSError: if the file cannot be written, or there is no room for all that is expected.
        """
        if self._count % self._block or len(rows) > self._block:
            raise OctarmError(f"{len(rows)} rows follow {self._count}, in blocks of {self._block}")
        with self._failures():
            if not self._count:
                self._begin(rows)
            missing = self._block - len(rows)
            for _, array in rows.arrays():
                self._opened.write(np.ascontiguousarray(array, _NUMBER).data)
                self._opened.write(np.full((missing, *array.shape[1:]), np.nan).data)
            self._opened.flush()
        self._count += len(rows)

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes the `.npz`, whole or not at all, the same bytes as `Trajectory.save` would.

        Raises:
            OSError: if it cannot be written.
        """
        with whole_file(path) as part, zipfile.ZipFile(part, "w") as file:
            for name, shape in self._layout.shapes.items():
                with file.open(f"{name}.npy", "w", force_zip64=True) as member:
                    header = {"descr": "<f8", "fortran_order": False, "shape": (len(self), *shape)}
                    np.lib.format.write_array_header_1_0(member, header)
                    for numbers in self._numbers(name):
                        member.write(numbers)
            if self._layer is not None:
                with file.open("layer.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, self._layer)
            for name in TEXTS:
                with file.open(f"{name}.npy", "w", force_zip64=True) as member:
                    np.lib.format.write_array(member, np.array(getattr(self.ending, name)))

    @property
    def _opened(self) -> IO[bytes]:
        if self._file is None:
            raise OctarmError(f"{self._path} is not open")
        return self._file

    def _begin(self, rows: Trajectory) -> None:
        self._layer = rows.layer
        shapes = {name: array.shape[1:] for name, array in rows.arrays()}
        layer = None if rows.layer is None else rows.layer.tolist()
        known = {"rows": self._block, "shapes": shapes, "layer": layer}
        head = json.dumps(known).encode() + b"\n"
        self._opened.write(head)
        self._layout = _Layout(len(head), self._block, shapes)
        # Once as blocks and, before they are removed, once more as arrays.
        needed = 2 * self._layout.block * (self._expected / self._block)
        free = shutil.disk_usage(self._path.parent).free
        if needed > free:
            sizes = f"{1e-9 * needed:.3g} GB on disk, of which {1e-9 * free:.3g} GB are free"
            raise OSError(f"so many rows take {sizes}")

    def _numbers(self, name: str) -> Iterator[bytes]:
        """Those of an array, block by block."""
        layout, left = self._layout, len(self)
        for place in itertools.count(layout.start + layout.place(name), layout.block):
            if left <= 0:
                return
            self._opened.seek(place)
            yield self._opened.read(min(left, layout.rows) * layout.row(name))
            left -= layout.rows

    @contextlib.contextmanager
    def _failures(self) -> Generator[None]:
        try:
            yield
        except OSError as error:
            raise OSError(f"{self._path} cannot be written: {error.strerror or error}") from error


def read_blocks(path: str | os.PathLike[str]) -> Trajectory:
    """What an `Archive` had added when its process was killed; the status is `interrupted`.

    Raises:
        ValueError: if there is no whole block.
    """
    with open(path, "rb") as file:
        head = file.readline()
    try:
        known = json.loads(head)
        shapes = {name: tuple(shape) for name, shape in known["shapes"].items()}
        layout = _Layout(len(head), int(known["rows"]), shapes)
    except (KeyError, TypeError, ValueError):
        raise OctarmError(f"{path} holds no rows") from None
    count = (os.path.getsize(path) - layout.start) // layout.block
    if count < 1:
        raise OctarmError(f"{path} holds no rows")
    fields = [(name, _NUMBER, (layout.rows, *shape)) for name, shape in shapes.items()]
    blocks = np.memmap(path, np.dtype(fields), "r", layout.start, (count,))
    rows = int(np.count_nonzero(np.isfinite(blocks["t"])))
    arrays = {
        name: np.asarray(blocks[name]).reshape(count * layout.rows, *shape)[:rows]
        for name, shape in shapes.items()
    }
    end = f"killed after t = {arrays['t'][-1]:.6g} s"
    texts = {"status": "interrupted", "message": end, "digest": ""}
    if known.get("layer") is not None:
        arrays["layer"] = np.array(known["layer"])
    return Trajectory.from_arrays(arrays, texts)


def mapped(path: str | os.PathLike[str]) -> Trajectory:
    """What `Trajectory.save` or `Archive.save` wrote, read from disk as far as it is looked at.

    Raises:
        ValueError: if the file is not a trajectory, or is damaged.
    """
    try:
        with zipfile.ZipFile(path) as file:
            if file.testzip() is not None or any(i.compress_type for i in file.infolist()):
                return Trajectory.load(path)  # says what is wrong, or unpacks it
            places = {i.filename.removesuffix(".npy"): i.header_offset for i in file.infolist()}
        arrays = {name: _mapped_array(path, place) for name, place in places.items()}
    except (ValueError, struct.error, zipfile.BadZipFile) as error:
        raise OctarmError(f"{path} is not a trajectory file ({error})") from None
    texts = {name: str(arrays.pop(name)) for name in TEXTS if name in arrays}
    try:
        return Trajectory.from_arrays(arrays, texts)
    except KeyError as error:
        raise OctarmError(f"{path} is not a trajectory file ({error})") from None


def _mapped_array(path: str | os.PathLike[str], place: int) -> np.ndarray:
    """The array of a zip member that is not compressed."""
    with open(path, "rb") as file:
        file.seek(place + _LOCAL_HEADER - 4)
        file.seek(sum(struct.unpack("<HH", file.read(4))), os.SEEK_CUR)
        if np.lib.format.read_magic(file) != (1, 0):
            raise OctarmError("an array of another format")
        shape, fortran, dtype = np.lib.format.read_array_header_1_0(file)
        if not math.prod(shape):
            return np.empty(shape, dtype)
        order = "F" if fortran else "C"
        return np.asarray(np.memmap(path, dtype, "r", file.tell(), shape, order))

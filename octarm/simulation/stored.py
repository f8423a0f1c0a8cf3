"""Reading the arrays of a `.npz` as this program writes them, and none of another kind."""

from __future__ import annotations

import contextlib
import math
import os
import warnings
import zipfile
from typing import IO, Any, Literal

import numpy as np
from numpy.lib import format as npy

from octarm.errors import OctarmError

NUMBER = np.dtype("<f8")  # of all arrays but the texts
_WORD = "<U"  # how the kinds of texts begin


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

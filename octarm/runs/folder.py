"""A run on disk: a folder with the recording, the arrays, and what was run.

The arrays are appended block by block while the run goes on. A block is one structured number in
NumPy's own format, whose fields are the arrays of the block. So memory holds one block, however
long the run is, and blocks can be read although the process was killed.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import os
import shutil
import zipfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.lib import format as npy

from octarm import formats
from octarm.arm.parameters import ArmParameters
from octarm.arrays import plain
from octarm.errors import OctarmError, similar
from octarm.files import whole_file, write_text, writing
from octarm.html import notebook_cell
from octarm.interfaces import Controller, Rows
from octarm.roll_off import fields_of
from octarm.runs.description import Description
from octarm.simulation.trajectory import NUMBER, Ending, Trajectory, joined

RECORDING = "run.rrd"
ARRAYS = "run.npz"
DESCRIPTION = "run.json"
BLOCKS = ARRAYS + ".blocks"  # what a killed run leaves of its arrays
RUNNING = "running"  # status of a run that is still going on, or was killed
SUMS = "sha256"  # key of run.json, whose table `checksums` gives
_LONGEST_HEADER = 10_000_000  # of a block [byte]
NAMED = ("versions", "host")  # keys whose values may differ between a run and its repetition


def gains_of(controller: Controller) -> dict[str, Any]:
    """A controller's gains, ready for JSON: its fields but the nominal model."""
    fields = fields_of(controller).items()
    return {name: _plain(value) for name, value in fields if name != "nominal"}


def describe_fields(thing: Any) -> dict[str, Any]:
    """The fields of a frozen dataclass, ready for JSON; parameters and arrays become lists.

    Other things have none, and fields of other kinds are described by the name of their class.
    """
    if not dataclasses.is_dataclass(thing):
        return {}
    return {f.name: _plain(getattr(thing, f.name)) for f in dataclasses.fields(thing)}


def _plain(value: Any) -> Any:
    if isinstance(value, ArmParameters):
        return value.to_dict()
    if isinstance(value, tuple):
        return [_plain(item) for item in cast(tuple[Any, ...], value)]
    if dataclasses.is_dataclass(value):
        return describe_fields(value)
    if value is None or isinstance(value, str | bool | int | float | list | np.ndarray):
        return plain(cast(Any, value))
    return plain(value.item()) if isinstance(value, np.generic) else type(value).__name__


def write_description(folder: Path, description: Mapping[str, Any]) -> None:
    """Writes `run.json`, with the version of its format and the `checksums` of what is there.

    Raises FileError if it cannot be written.
    """
    content = written(description)
    _write(folder, content, checksums(folder, content))


def written(description: Mapping[str, Any]) -> dict[str, Any]:
    """What `run.json` holds of a description, as it is read back; its checksums are missing."""
    content = {"format": formats.FORMAT, **description}
    content.pop(SUMS, None)
    return json.loads(formats.to_json(content))


def checksums(folder: Path, content: Mapping[str, Any]) -> dict[str, str]:
    """The SHA-256 of each file of a run that is there, and that of the content of `run.json`.

    The latter covers what no repetition of the run can tell, such as its command; versions and
    machine are left out, and so is this table.
    """
    files = [folder / name for name in (ARRAYS, RECORDING)]
    covered = {key: value for key, value in content.items() if key not in (*NAMED, SUMS)}
    text = json.dumps(covered, sort_keys=True)
    sums = {file.name: _checksum(file) for file in files if file.is_file()}
    return {**sums, DESCRIPTION: hashlib.sha256(text.encode()).hexdigest()}


def note_recording(folder: Path) -> None:
    """Enters a recording that was made again into `run.json`, which stays as it is otherwise.

    Raises OctarmError if the folder holds no run, FileError if it cannot be written.
    """
    content = read_description(folder)
    stated = content.get(SUMS)
    table = cast(dict[str, Any], stated) if isinstance(stated, dict) else {}
    _write(folder, content, {**table, RECORDING: _checksum(folder / RECORDING)})


def _write(folder: Path, content: Mapping[str, Any], sums: Mapping[str, Any]) -> None:
    """Writes `run.json`, whose checksums end the line of the command.

    Two runs of the same experiment then differ in this line alone.
    """
    others = {key: value for key, value in content.items() if key != SUMS}
    text = formats.to_json(others).removesuffix("\n}\n")
    write_text(folder / DESCRIPTION, f"{text}, {json.dumps({SUMS: sums})[1:]}\n")


def _checksum(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read_description(folder: Path) -> dict[str, Any]:
    """What was run, from `run.json`.

    Raises OctarmError if it is no run, one of another format, or a value is not allowed.
    """
    path = folder / DESCRIPTION
    if not os.path.isfile(path):  # nor is what cannot be a file's name
        files = folder.glob(f"*/{DESCRIPTION}") if os.path.isdir(folder) else ()
        inside = sorted(file.parent.name for file in files)
        # Of many the last ones, as those of dated runs are.
        listed = ", ".join(inside[-8:]) + (" and others" if len(inside) > 8 else "")
        runs = f"; the runs in it are {listed}" if inside else ""
        if not os.path.lexists(folder):
            beside = folder.parent.glob(f"*/{DESCRIPTION}")
            runs = similar(folder.name, (file.parent.name for file in beside))
        raise OctarmError(f"{folder} is not a run folder: it has no {DESCRIPTION}{runs}")
    document = formats.read_json(path)
    if "controller" not in document.content:
        raise OctarmError(f"{path} does not describe a run: it has no controller")
    formats.check_format(document)
    document.read(Description)
    if ArmParameters.from_dict(document.content["parameters"]).batch_shape:
        raise OctarmError(f"{path} has the parameters of several arms; a run is of one")
    return dict(document.content)


class Run(NamedTuple):
    """A run as its folder holds it; it can be unpacked into its two attributes.

    Attributes:
        trajectory: what happened at each control instant.
        description: the content of `run.json`: what was run, with which versions, its metrics.
    """

    trajectory: Trajectory
    description: dict[str, Any]

    @property
    def metrics(self) -> dict[str, Any]:
        """The metrics by name [SI]: a number, a list with one a coordinate, or None."""
        return self.description["metrics"]

    def _repr_html_(self) -> str:
        """What a notebook shows of it."""
        run, description = self
        acting = ", ".join(entry["name"] for entry in description.get("disturbances", []))
        title = f"{description['controller']['name']} on {description['reference']['name']}"
        lines = [f"{len(run)} control instants, {run.message or run.status}"]
        lines += [f"disturbances: {acting}"] if acting else []
        return notebook_cell(title, lines, run.table())


def read_run(folder: str | Path) -> Run:
    """The run of a folder, in memory.

    Raises OctarmError if the folder holds no run.
    """
    description = read_description(Path(folder))
    return Run(Trajectory.load(Path(folder) / ARRAYS), description)


def map_run(folder: Path) -> Run:
    """The same, read from disk as far as it is looked at; what there is of a run that was killed.

    Raises OctarmError if the folder holds no run, or no rows of it.
    """
    description = read_description(folder)
    arrays, blocks = folder / ARRAYS, folder / BLOCKS
    if arrays.is_file():
        run = Trajectory.load(arrays, mapped=True)
    elif blocks.is_file():
        run = read_blocks(blocks)
    else:
        raise OctarmError(f"{folder} has no {ARRAYS}: it is incomplete")
    if not len(run) or not np.isfinite(run.t).all():
        raise OctarmError(f"{arrays} holds no rows")
    return Run(run, description)


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
        with writing(self._path):
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

    def add(self, rows: Rows, layer: np.ndarray | None = None) -> None:
        """Appends a block of rows; they are with the operating system afterwards.

        The half width of the boundary layer has shape (2N,) [m/s], [rad/s], if there is one. Raises
        FileError if the file cannot be written, or there is no room for all that is expected.
        """
        arrays = rows if layer is None else {**rows, "layer": layer}
        block = np.empty((), [(name, NUMBER, np.shape(x)) for name, x in arrays.items()])
        for name, array in arrays.items():
            block[name] = array
        with writing(self._path):
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
                    shape = (self._count, *first.shape[1:])
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
        """Raises OSError unless all rows of so many bytes fit twice: as blocks, and as arrays."""
        needed, free = 2 * row * self._expected, shutil.disk_usage(self._path.parent).free
        if needed > free:
            sizes = f"{1e-9 * needed:.3g} GB on disk, of which {1e-9 * free:.3g} GB are free"
            raise OSError(f"so many rows take {sizes}")


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

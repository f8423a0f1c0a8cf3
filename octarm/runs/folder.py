"""A run on disk: a folder with the recording, the arrays, and what was run."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np

from octarm import formats
from octarm.arm.parameters import ArmParameters
from octarm.arrays import plain
from octarm.errors import OctarmError, similar
from octarm.files import write_text
from octarm.html import notebook_cell
from octarm.interfaces import Controller
from octarm.roll_off import fields_of
from octarm.runs.archive import read_blocks
from octarm.runs.description import Description
from octarm.simulation.trajectory import Trajectory

RECORDING = "run.rrd"
ARRAYS = "run.npz"
DESCRIPTION = "run.json"
BLOCKS = ARRAYS + ".blocks"  # what a killed run leaves of its arrays
RUNNING = "running"  # status of a run that is still going on, or was killed
SUMS = "sha256"  # key of run.json, whose table `checksums` gives
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
        runs = f"; the runs in it are {_listed(inside)}" if inside else ""
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


def _listed(names: list[str]) -> str:
    """Names as they stand in a sentence; of many the last ones, as those of dated runs are."""
    return ", ".join(names) if len(names) <= 8 else f"{', '.join(names[-8:])} and others"


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
    folder = Path(folder)
    description = read_description(folder)
    return Run(Trajectory.load(folder / ARRAYS), description)


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

"""The `.rrd` file of rerun: written whole or not at all, in rows, and read back."""

from __future__ import annotations

import contextlib
import os
import pathlib
import re
from collections.abc import Generator, Iterator, Mapping
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr

from octarm.errors import OctarmError
from octarm.files import piped, whole_file

Path = str | os.PathLike[str]

_VERSIONS = re.compile(r"## Versions\n.*?(?=\n## |\Z)", re.DOTALL)  # on the page `notes`


@contextlib.contextmanager
def rrd_file(path: Path, application: str = "octarm") -> Generator[rr.RecordingStream]:
    """A stream to a `.rrd` file, which appears whole or not at all.

    It is `PATH.part` until the block ends well, and stays that if the process is killed. Recordings
    of one application share a layout in the viewer, with its titles. Raises OSError if the file
    cannot be written, OctarmError if rerun does not take the data, or is switched off by RERUN=off.
    """
    if os.environ.get("RERUN", "on").lower() in ("0", "off", "false"):
        raise OctarmError(f"{path} cannot be recorded: RERUN={os.environ['RERUN']} is set")
    named = pathlib.Path(f"{os.fspath(path)}.part")
    with whole_file(path, named) as part, contextlib.ExitStack() as file:
        # Without it rerun would warn of bad data, and drop it.
        file.callback(rr.set_strict_mode, rr.strict_mode())
        rr.set_strict_mode(True)
        with rerun_errors(path):
            stream = rr.RecordingStream(application, send_properties=False)
            # rerun itself would hang for ever on a full disk
            stream.save(file.enter_context(piped(part)))
            file.enter_context(stream)
        try:
            yield stream
        except BaseException:
            with contextlib.suppress(Exception):  # the error is known already
                file.close()
            raise
        with rerun_errors(path):
            file.close()


@contextlib.contextmanager
def rerun_errors(path: Path) -> Generator[None]:
    """Turns rerun's RuntimeErrors into an `OctarmError` that names the file."""
    try:
        yield
    except RuntimeError as error:
        raise OctarmError(f"{path} cannot be recorded: {_first_line(error)}") from error


def times(t: np.ndarray) -> list[rr.TimeColumn]:
    """The timeline `t` of rows at times of shape (k,) [s]."""
    stamps = np.round(t * 1e9).astype("timedelta64[ns]")  # rerun would truncate
    return [rr.TimeColumn("t", duration=stamps)]


def structures(columns: Mapping[str, np.ndarray], name: str) -> Any:
    """Rows as one structure `octarm:name`: one set of times makes the file half as large.

    Columns have the shape (k,) if they are numbers, and (k, width) if they are lists.
    """
    lists: list[Any] = []
    for values in columns.values():
        # Arrow takes the memory as it is; arrays in a file may begin at any byte of it.
        flat = pa.array(np.require(values, requirements=["C", "ALIGNED"]).ravel())
        one = values.ndim == 1
        lists.append(flat if one else pa.FixedSizeListArray.from_arrays(flat, values.shape[1]))
    table = pa.StructArray.from_arrays(lists, names=list(columns))
    return rr.DynamicArchetype.columns("octarm", components={name: table})


def contents(path: Path) -> dict[str, pa.Array]:
    """What a recording holds: values by entity and component, the times `t` among them.

    Rows come in the order in which they were recorded; of static values these are the last ones.
    Left out are the numbers that rerun gives to its pieces, the layout of the viewer, and the table
    of versions in the notes. Raises OctarmError if the file is not a recording.
    """
    parts: dict[str, list[pa.Array]] = {}
    try:
        for chunk in rr.chunk.RrdReader(str(path)).stream():
            batch = chunk.to_record_batch()
            for field, column in zip(batch.schema, batch.columns, strict=True):
                metadata: dict[bytes, bytes] = field.metadata or {}
                if metadata.get(b"rerun:kind") == b"control":
                    continue
                key = f"{chunk.entity_path} {field.name}"
                if key == "/notes TextDocument:text":
                    texts = [[_VERSIONS.sub("", t) for t in row] for row in column.to_pylist()]
                    column = pa.array(texts, column.type)
                if chunk.is_static:  # one chunk or several, as time allowed; the last row counts
                    parts[key] = [column[-1:]]
                else:
                    parts.setdefault(key, []).append(column)
        return {key: pa.concat_arrays(columns) for key, columns in parts.items()}
    except Exception as error:  # those of rerun and Arrow are of many kinds
        reason = " ".join(str(error).split())
        raise OctarmError(f"{path} is not a recording ({reason})") from None


def last_instant(path: Path) -> float:
    """The last instant of a recording [s].

    Raises OctarmError if the file is not a recording, or has no instants.
    """
    ends = [t.max() for _, _, t in _temporal(path)]
    if not ends:
        raise OctarmError(f"{path} is a recording without instants")
    return float(max(ends)) * 1e-9


def telling_instant(path: Path) -> float:
    """The instant at which a recording says most [s].

    It is the one of the largest bend, or the last one of a run that diverged. Raises OctarmError if
    the file is not a recording, or has no instants.
    """
    end, largest, telling = last_instant(path), -1.0, 0.0
    for entity, batch, t in _temporal(path):
        if entity.endswith("states/run") and "diverged" in str(batch.to_pydict()):
            return end
        if "octarm:signals" in batch.schema.names:
            rows = pa.compute.list_flatten(batch.column("octarm:signals"))
            bends = rows.field("q_bends").flatten().to_numpy(zero_copy_only=False)
            size = np.nan_to_num(np.abs(bends).reshape(len(rows), -1).sum(axis=1))
            if size.max() > largest:
                largest, telling = float(size.max()), float(t[np.argmax(size)]) * 1e-9
    return telling


def _temporal(path: Path) -> Iterator[tuple[str, pa.RecordBatch, np.ndarray]]:
    """Entity, rows and times [ns] of each piece of a recording that has times."""
    try:
        for chunk in rr.chunk.RrdReader(os.fspath(path)).stream():
            batch = chunk.to_record_batch()
            if not chunk.is_static and "t" in batch.schema.names and batch.num_rows:
                yield chunk.entity_path, batch, batch.column("t").cast(pa.int64()).to_numpy()
    except Exception as error:  # rerun's errors are of many kinds
        raise OctarmError(f"{path} cannot be read: {_first_line(error)}") from None


def _first_line(error: Exception) -> str:
    return (str(error) or type(error).__name__).splitlines()[0]

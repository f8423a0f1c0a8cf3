"""A file of a sweep: the rows of a shard in Parquet, in which any damage is noticed.

Parquet protects the values by checksums, but neither the headers of its pages nor its footer, where
names, types and metadata stand. So the footer of each file holds the SHA-256 of all its other
bytes, which is looked at before anything is made of them. It does not matter which version of
pyarrow wrote them, nor which columns are asked for.
"""

from __future__ import annotations

import hashlib
import io
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from octarm.errors import OctarmError, closest
from octarm.files import whole_file

_MARK = b"sha256:"
_OPEN = b"." * 64  # holds the place of the digest, and counts for it


def write_shard(file: Path, table: pa.Table, labels: Mapping[str, Any]) -> None:
    """Writes rows whole or not at all.

    Args:
        file: to write.
        table: its rows; the metadata of its schema are kept.
        labels: more of them, as JSON has them.

    Raises:
        OSError: if it cannot be written.
    """
    own = {key: json.dumps(value) for key, value in labels.items()}
    content = shard_bytes(table.replace_schema_metadata({**metadata_of(table.schema), **own}))
    with whole_file(file) as part:
        part.write_bytes(content)


def shard_bytes(table: pa.Table) -> bytes:
    """The content of a file, with its digest."""
    sink = io.BytesIO()
    pq.write_table(
        table.replace_schema_metadata({**metadata_of(table.schema), b"digest": _MARK + _OPEN}),
        sink,
        compression="zstd",
        use_dictionary=False,
        write_statistics=False,
    )
    content = sink.getvalue()
    before, after = _around(content)
    return before + _digest(before, after) + after


def read_shard(file: Path, columns: Sequence[str] | None = None) -> pa.Table:
    """The rows in a file; the metadata of the schema are what `labels_of` reads.

    Args:
        file: to read.
        columns: names of those to read, all when not given. Damage elsewhere is noticed, too.

    Raises:
        ValueError: if it is damaged, or lacks a column.
        OSError: if it cannot be read.
    """
    content = file.read_bytes()
    before, after = _around(content)
    if content[len(before) : len(content) - len(after)] != _digest(before, after):
        raise OctarmError(f"{file} is damaged: it does not have the digest that it states")
    # Without threads: one that ends after the interpreter aborts the process when it frees a buffer
    # that is Python's.
    with pq.ParquetFile(pa.BufferReader(content)) as stored:
        known = stored.schema_arrow.names
        for name in columns or ():
            if name not in known:
                raise OctarmError(f"{file} has no column {name!r}{closest(name, known)}")
        names = None if columns is None else [*columns]
        return stored.read(columns=names, use_threads=False)


def labels_of(table: pa.Table) -> dict[str, Any]:
    """The labels of rows that were read."""
    found = metadata_of(table.schema)
    return {key.decode(): json.loads(text) for key, text in found.items() if key != b"digest"}


def metadata_of(thing: pa.Schema | pa.Field) -> dict[bytes, bytes]:
    """The metadata of a schema or of a field; none are an empty table."""
    return thing.metadata or {}


def _around(content: bytes) -> tuple[bytes, bytes]:
    """What stands before and after the digest; a file without one is all before it."""
    mark = content.rfind(_MARK)
    place = len(content) if mark < 0 else mark + len(_MARK)
    return content[:place], content[place + len(_OPEN) :]


def _digest(before: bytes, after: bytes) -> bytes:
    digest = hashlib.sha256(before)
    digest.update(_OPEN)
    digest.update(after)
    return digest.hexdigest().encode()

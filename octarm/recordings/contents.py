"""What a recording holds, apart from the numbers that rerun gives to its pieces."""

from __future__ import annotations

import re

import pyarrow as pa
import rerun as rr

from octarm.errors import OctarmError
from octarm.recordings.rrd import Path

_VERSIONS = re.compile(r"## Versions\n.*?(?=\n## |\Z)", re.DOTALL)  # on the page `notes`


def contents(path: Path) -> dict[str, pa.Array]:
    """All values by entity and component, the times `t` of an entity among them.

    Rows come in the order in which they were recorded; of static values these are the last ones.
    Left out are the layout of the viewer, and the table of versions in the notes. Raises
    OctarmError if the file is not a recording.
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

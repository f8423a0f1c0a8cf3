"""A sweep on disk: `spec.toml`, `manifest.json` and `episodes/*.parquet`, one file a shard."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, cast

import pyarrow as pa

from octarm.errors import OctarmError
from octarm.sweeps.shard_file import labels_of, read_shard

SPEC = "spec.toml"
MANIFEST = "manifest.json"
EPISODES = "episodes"
RECORDED = "recorded"  # run folders of chosen episodes


def read_sweep(folder: str | Path, columns: Sequence[str] | None = None) -> pa.Table:
    """The finished episodes of a sweep, a row each, in the order of their numbers.

    Args:
        folder: of the sweep.
        columns: names of those to read; all when not given. Metadata of a field holds its `unit`.

    Raises:
        ValueError: if the folder holds no sweep, no finished shard or a damaged one.
    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    shards = [_read(folder, manifest, shard, columns) for shard in manifest["shards"]]
    tables = [table.replace_schema_metadata(None) for table in shards if table is not None]
    if not tables:
        raise OctarmError(f"{folder} has no finished episode yet")
    return pa.concat_tables(tables)


def read_schema(folder: str | Path) -> pa.Schema:
    """The columns of a sweep's table; metadata of a field holds its `unit`.

    Raises:
        ValueError: if the folder holds no sweep, or no finished shard.
    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    for shard in manifest["shards"]:
        if (table := _read(folder, manifest, shard)) is not None:
            return table.schema
    raise OctarmError(f"{folder} has no finished episode yet")


def read_row(folder: str | Path, episode: int) -> pa.Table:
    """The row of an episode.

    The metadata of its schema say where and with which versions it was run, `host` and `versions`;
    see `octarm.sweeps.shard_file.labels_of`.

    Raises:
        ValueError: if the folder holds no sweep, or the episode is not finished or damaged.
    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    for shard in manifest["shards"]:
        place = episode - shard["first"]
        if 0 <= place < shard["episodes"]:
            table = _read(folder, manifest, shard)
            if table is not None:
                return table.slice(place, 1)
    raise OctarmError(f"episode {episode} of {folder} is not finished; --resume runs it")


def read_manifest(folder: Path) -> dict[str, Any]:
    """What `manifest.json` says.

    Raises:
        ValueError: if the folder holds no sweep.
    """
    file = folder / MANIFEST
    try:
        manifest: Any = json.loads(file.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        raise OctarmError(f"{folder} is not a sweep: it has no {MANIFEST}") from None
    except ValueError as error:
        raise OctarmError(f"{file} is not readable ({error})") from None
    held = cast(dict[str, Any], manifest if isinstance(manifest, dict) else {})
    if missing := {"spec", "spec_hash", "gains", "starts", "shards"} - set(held):
        raise OctarmError(
            f"{file} does not describe a sweep: it lacks {', '.join(sorted(missing))}"
        )
    return held


def shard_name(shard: int) -> str:
    """The file of a shard."""
    return f"{shard:05d}.parquet"


def _read(
    folder: Path,
    manifest: Mapping[str, Any],
    shard: Mapping[str, Any],
    columns: Sequence[str] | None = None,
) -> pa.Table | None:
    """The rows of a shard, given its entry in the manifest; None if it is not finished.

    Raises:
        ValueError: if it is damaged, or another one.
    """
    file = folder / shard["file"]
    try:
        table = read_shard(file, columns)
    except FileNotFoundError:
        return None
    except ValueError as error:
        raise OctarmError(f"{error}; --resume runs it again") from None
    episodes = range(shard["first"], shard["first"] + shard["episodes"])
    if not is_shard(table, manifest["spec_hash"], episodes):
        raise OctarmError(f"{file} is not that shard of this sweep; --resume runs it again")
    return table


def labels(spec_hash: str, first: int) -> dict[str, Any]:
    """What a shard says of itself: of which sweep it is, and its first episode."""
    return {"spec": spec_hash, "first": first}


def is_shard(table: pa.Table, spec_hash: str, episodes: range) -> bool:
    """Whether rows are those of these episodes of this sweep."""
    found, expected = labels_of(table), labels(spec_hash, episodes.start)
    return len(table) == len(episodes) and all(found.get(k) == v for k, v in expected.items())

"""A sweep on disk: `spec.toml`, `manifest.json` and `episodes/*.parquet`, one file a shard.

The manifest holds the SHA-256 of `spec.toml` and of every finished shard: from it hashes chain to
every byte. It is written before the shard gets its name, so that a file with that name is known,
whenever the process is killed. All that the spec decides has to be what the spec decides, so that
nothing is missing, doubled or in another order. A file is compared with its SHA-256 before anything
is made of its bytes; a shard and its SHA-256 that were changed together are found by
`octarm verify` alone, which runs episodes again.
"""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import io
import itertools
import json
import os
import re
import shutil
from collections.abc import Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import filelock
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import AfterValidator, Field

from octarm.errors import FileError, OctarmError, closest, quoted
from octarm.files import read_bytes, whole_file, write_text
from octarm.formats import FORMAT, Array, Model, check_format, read_json, spelt, to_json
from octarm.runs.versions import host, versions
from octarm.sweeps.plan import Plan
from octarm.sweeps.spec_file import parse_spec

SPEC = "spec.toml"
MANIFEST = "manifest.json"
EPISODES = "episodes"
RECORDED = "recorded"  # run folders of selected episodes
PROGRESS = ".progress"  # how far the shards at work are; only while a sweep runs
LOCK = ".lock"


def _sum(text: str) -> str:
    if not re.fullmatch(r"[0-9a-f]{64}|", text):
        raise ValueError("a SHA-256, or empty")
    return text


class _Start(Model):
    time: str
    versions: dict[str, Any]
    host: dict[str, Any]


class _Shard(Model):
    file: str
    first: int
    episodes: int
    sha256: Annotated[str, AfterValidator(_sum)]  # empty until it is finished


class _Manifest(Model):
    format: int
    spec: dict[str, Any]
    spec_hash: str
    spec_sha256: str
    episodes: int
    gains: dict[str, dict[str, Any]]
    starts: Annotated[Array[_Start], Field(min_length=1)]
    shards: Array[_Shard]


def new_manifest(plan: Plan, gains: Mapping[str, Any], spec_file: bytes) -> dict[str, Any]:
    """The manifest of a sweep that begins, without a start.

    It holds the gains of each controller for the nominal arm; `spec_file` are the bytes of
    `spec.toml`.
    """
    return {
        "format": FORMAT,
        "spec": plan.spec.content(),
        "spec_hash": plan.spec.hash(),
        "spec_sha256": hashlib.sha256(spec_file).hexdigest(),
        "episodes": plan.episodes,
        "gains": gains,
        "shards": [
            {
                "file": f"{EPISODES}/{i:05d}.parquet",
                "first": plan.shard(i).start,
                "episodes": len(plan.shard(i)),
                "sha256": "",
            }
            for i in plan.shards
        ],
        "starts": [],
    }


def open_sweep(folder: Path) -> tuple[Plan, dict[str, Any]]:
    """The plan of a sweep folder and its manifest, which agree; all that reads a sweep begins here.

    Raises OctarmError if it is no sweep, one of another format, or one whose files were changed.
    """
    file = folder / MANIFEST
    if not os.path.isfile(file):  # nor is what cannot be a file's name
        raise OctarmError(f"{folder} is not a sweep: it has no {MANIFEST}")
    document = read_json(file)
    check_format(document)
    document.read(_Manifest)
    manifest = dict(document.content)
    content = read_bytes(folder / SPEC)
    if hashlib.sha256(content).hexdigest() != manifest["spec_sha256"]:
        raise OctarmError(
            f"{folder / SPEC} was changed: it is not what the sweep was run with, or {MANIFEST} "
            "was changed"
        )
    plan = Plan(parse_spec(content.decode("utf-8", "replace"), str(folder / SPEC)))
    right = new_manifest(plan, dict.fromkeys(plan.spec.controllers), content)
    shards = [{**shard, "sha256": ""} for shard in manifest["shards"]]
    stated = {**manifest, "starts": [], "gains": dict.fromkeys(manifest["gains"]), "shards": shards}
    for key, value in right.items():
        if stated[key] != value:
            raise OctarmError(f"{file} was changed: {key} is not what {SPEC} says")
    return plan, manifest


def read_sweep(folder: str | Path, columns: Sequence[str] | None = None) -> pa.Table:
    """The finished episodes of a sweep, a row each, in the order of their numbers.

    The columns are all of them where none are named; metadata of a field holds its `unit`. Raises
    OctarmError if the folder holds no sweep, no finished shard or a damaged one.
    """
    shards = _shards(Path(folder), columns=columns)
    return pa.concat_tables([table.replace_schema_metadata(None) for table in shards])


def read_schema(folder: str | Path) -> pa.Schema:
    """The columns of a sweep's table; see `read_sweep`."""
    return next(_shards(Path(folder))).schema


def origin_of(table: pa.Table) -> dict[str, Any]:
    """What `run_shard` says of rows: `host` and `versions` where they were made, and `gains`."""
    return {key.decode(): json.loads(text) for key, text in metadata_of(table.schema).items()}


def metadata_of(thing: pa.Schema | pa.Field) -> dict[bytes, bytes]:
    """The metadata of a schema or of a field; none are an empty table."""
    return thing.metadata or {}


def shard_bytes(table: pa.Table) -> bytes:
    """The content of the file of a shard."""
    sink = io.BytesIO()
    pq.write_table(table, sink, compression="zstd", use_dictionary=False, write_statistics=False)
    return sink.getvalue()


class SweepFolder:
    """The folder of one sweep, from which finished shards are never lost.

    Every file appears whole or not at all, and only this process writes.
    """

    def __init__(self, path: Path, plan: Plan) -> None:
        """A folder for the shards of a plan; nothing is written yet."""
        self.path = path
        self._plan = plan
        self._manifest: dict[str, Any] = {}

    def check(self, *, resume: bool, replace: bool = False) -> None:
        """Raises OctarmError if the folder holds something else, or a sweep that may not go on.

        The same sweep may `resume`; another one may be there if it is to be replaced.
        """
        if self.path.exists() and not self.path.is_dir():
            raise OctarmError(f"{self.path} is not a folder; choose another --out")
        names = {entry.name for entry in self.path.iterdir()} if self.path.exists() else set[str]()
        if MANIFEST not in names:
            if names - {LOCK, PROGRESS, SPEC, EPISODES}:
                raise OctarmError(f"{self.path} exists and is not a sweep; choose another --out")
            return
        if replace:
            return
        if not resume:
            raise OctarmError(
                f"{self.path} holds a sweep already; go on with it by --resume, replace it by "
                "--force, or choose another --out"
            )
        before, now = open_sweep(self.path)[1]["spec"], self._plan.spec.content()
        for key in (*before, *now):
            if before.get(key) != now.get(key):
                old, new = (
                    f"is {spelt(content[key])}" if key in content else "is not given"
                    for content in (before, now)
                )
                raise OctarmError(
                    f"{self.path} was begun with another spec: {key} {old} there and {new} here"
                )

    @contextlib.contextmanager
    def locked(self) -> Generator[None]:
        """Makes the folder, and keeps other processes from writing there."""
        lock = filelock.FileLock(self.path / LOCK, timeout=0)
        try:
            (self.path / EPISODES).mkdir(parents=True, exist_ok=True)
            lock.acquire()
        except filelock.Timeout:
            raise OctarmError(f"another process is at work on {self.path}") from None
        except OSError as error:
            raise FileError(f"{self.path} cannot be written: {error.strerror}") from None
        except NotImplementedError:  # some network file systems have no locks
            pass
        try:
            yield
        finally:
            lock.release()

    def clear(self) -> None:
        """Removes the sweep that is there; to be called while the folder is locked."""
        (self.path / MANIFEST).unlink(missing_ok=True)  # without it there is no sweep
        for name in (EPISODES, RECORDED):
            shutil.rmtree(self.path / name, ignore_errors=True)
        (self.path / SPEC).unlink(missing_ok=True)
        (self.path / EPISODES).mkdir()

    def begin(self, gains: Mapping[str, Any]) -> list[str]:
        """Writes what the sweep is, or notes that it goes on; its gains may not change.

        Returns:
            Which versions have changed since it was begun, a sentence each.
        """
        spec = self._plan.spec
        start: dict[str, Any] = {
            "time": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            "versions": versions(spec.engine, spec.code),
            "host": host(),
        }
        if (self.path / MANIFEST).exists():
            self._manifest = open_sweep(self.path)[1]
            for name, values in gains.items():
                if self._manifest["gains"].get(name) != values:
                    raise OctarmError(
                        f"{self.path} was begun with other gains of {name}: this version "
                        "recommends others"
                    )
        else:
            whole = spec.text and parse_spec(spec.text) == spec
            text = spec.text if whole else spec.to_toml()
            self._manifest = new_manifest(self._plan, gains, text.encode())
            write_text(self.path / SPEC, text)
        self._manifest["starts"].append(start)
        self._write_manifest()
        before = self._manifest["starts"][0]["versions"]
        return [
            f"{name} was {before.get(name, 'absent')} when the sweep was begun and is {now} now"
            for name, now in start["versions"].items()
            if name != "platform" and before.get(name) != now
        ]

    def finished(self) -> list[int]:
        """The shards that are there and undamaged; a damaged one is run again."""
        whole: list[int] = []
        for i in self._plan.shards:
            with contextlib.suppress(OctarmError):
                if read_shard(self.path, self._plan, self._manifest, i, ()) is not None:
                    whole.append(i)
        return whole

    def write(self, shard: int, table: pa.Table) -> None:
        """Writes a shard, and what the manifest says of it."""
        entry, content = self._manifest["shards"][shard], shard_bytes(table)
        with whole_file(self.path / entry["file"]) as part:
            part.write_bytes(content)
            entry["sha256"] = hashlib.sha256(content).hexdigest()
            self._write_manifest()

    def _write_manifest(self) -> None:
        write_text(self.path / MANIFEST, to_json(self._manifest))


def read_shard(
    folder: Path,
    plan: Plan,
    manifest: Mapping[str, Any],
    shard: int,
    columns: Sequence[str] | None = None,
) -> pa.Table | None:
    """The rows of a shard, which are those that were written; None if it is not finished.

    All columns are read where none are named. Raises OctarmError if the shard is damaged, has no
    such column, or holds other rows than those of the plan.
    """
    entry = manifest["shards"][shard]
    file = folder / entry["file"]
    if not (entry["sha256"] and file.exists()):
        return None
    content = read_bytes(file)
    if hashlib.sha256(content).hexdigest() != entry["sha256"]:
        raise OctarmError(
            f"{file} is damaged: it does not have the SHA-256 that {MANIFEST} states; "
            "--resume runs it again"
        )
    episodes = np.asarray(plan.shard(shard))
    rows = {"episode": episodes, "seed": plan.seeds(episodes), **plan.values(episodes)}
    needed = [*dict.fromkeys((*rows, *(columns or ())))]
    try:
        with pq.ParquetFile(pa.BufferReader(content)) as stored:
            known = stored.schema_arrow.names
            for name in needed:
                if name not in known:
                    raise OctarmError(f"{file} has no column {quoted(name)}{closest(name, known)}")
            # Without threads: one that ends after the interpreter aborts the process when it frees
            # a buffer that is Python's.
            table = stored.read(columns=None if columns is None else needed, use_threads=False)
    except (OSError, pa.ArrowException) as error:
        raise OctarmError(f"{file} is not a table ({error})") from None
    for name, values in rows.items():
        if not np.array_equal(table[name].to_numpy(), values):
            raise OctarmError(
                f"{file} does not hold the episodes that are planned there: {name} is another one"
            )
    controller = rows["controller"][0]
    if origin_of(table).get("gains") != manifest["gains"][controller]:
        raise OctarmError(f"{file} was run with other gains of {controller} than {MANIFEST} states")
    return table if columns is None else table.select([*columns])


def _shards(folder: Path, columns: Sequence[str] | None = None) -> Iterator[pa.Table]:
    """The rows of the finished shards, of which there is at least one."""
    plan, manifest = open_sweep(folder)
    tables = (read_shard(folder, plan, manifest, i, columns) for i in plan.shards)
    finished = (table for table in tables if table is not None)
    if (first := next(finished, None)) is None:
        raise OctarmError(f"{folder} has no finished episode yet")
    yield from itertools.chain([first], finished)

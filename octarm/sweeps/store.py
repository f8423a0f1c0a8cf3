"""A sweep on disk: `spec.toml`, `manifest.json` and `episodes/*.parquet`, one file a shard.

The manifest holds the SHA-256 of every finished shard. It is written before the shard gets its
name, so that a file with that name is known, whenever the process is killed. A file is compared
with its SHA-256 before anything is made of its bytes.
"""

from __future__ import annotations

import contextlib
import datetime
import hashlib
import io
import json
from collections.abc import Generator, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import filelock
import pyarrow as pa
import pyarrow.parquet as pq
from pydantic import Field, FiniteFloat

from octarm.errors import FileError, OctarmError, closest, quoted
from octarm.files import whole_file, write_text
from octarm.formats import FORMAT, Model, check_format, read_json, spelt, to_json
from octarm.runs.versions import host, versions
from octarm.sweeps.plan import Plan
from octarm.sweeps.spec_file import parse_spec

SPEC = "spec.toml"
MANIFEST = "manifest.json"
EPISODES = "episodes"
RECORDED = "recorded"  # run folders of selected episodes
PROGRESS = ".progress"  # how far the shards at work are; only while a sweep runs
_LOCK = ".lock"

_Count = Annotated[int, Field(ge=0, lt=2**53)]


class _Shard(Model):
    file: Annotated[str, Field(pattern=rf"^{EPISODES}/\d{{5,}}\.parquet$")]
    first: _Count
    episodes: _Count
    sha256: str


class _Start(Model):
    time: str
    versions: dict[str, str]
    host: dict[str, str | int | None]


class _Spec(Model, extra="allow"):
    """The content of a spec by dotted key, as far as all sweeps have the same keys."""

    duration: Annotated[FiniteFloat, Field(gt=0.0)]
    controllers: Annotated[list[str], Field(alias="grid.controller", min_length=1)]


class _Manifest(Model):
    """All that `manifest.json` holds."""

    format: int
    spec: _Spec
    spec_hash: str
    episodes: _Count
    gains: dict[str, dict[str, Any]]
    starts: Annotated[list[_Start], Field(min_length=1)]
    shards: list[_Shard]


def read_sweep(folder: str | Path, columns: Sequence[str] | None = None) -> pa.Table:
    """The finished episodes of a sweep, a row each, in the order of their numbers.

    Args:
        folder: of the sweep.
        columns: names of those to read; all when not given. Metadata of a field holds its `unit`.

    Raises:
        OctarmError: if the folder holds no sweep, no finished shard or a damaged one.
    """
    shards = _shards(Path(folder), columns=columns)
    return pa.concat_tables([table.replace_schema_metadata(None) for _, table in shards])


def read_schema(folder: str | Path) -> pa.Schema:
    """The columns of a sweep's table; see `read_sweep`."""
    return next(_shards(Path(folder)))[1].schema


def read_row(folder: str | Path, episode: int) -> pa.Table:
    """The row of an episode; the metadata of its schema are what `origin_of` reads.

    Raises:
        OctarmError: if the folder holds no sweep, or the episode is not finished or damaged.
    """
    first, table = next(_shards(Path(folder), episode=episode))
    return table.slice(episode - first, 1)


def origin_of(table: pa.Table) -> dict[str, Any]:
    """Where and with which versions rows were made, `host` and `versions`."""
    return {key.decode(): json.loads(text) for key, text in metadata_of(table.schema).items()}


def metadata_of(thing: pa.Schema | pa.Field) -> dict[bytes, bytes]:
    """The metadata of a schema or of a field; none are an empty table."""
    return thing.metadata or {}


def read_manifest(folder: Path) -> dict[str, Any]:
    """What `manifest.json` says.

    Raises:
        OctarmError: if the folder holds no sweep, one of another format, or a value is not allowed.
    """
    file = folder / MANIFEST
    if not file.is_file():
        raise OctarmError(f"{folder} is not a sweep: it has no {MANIFEST}")
    document = read_json(file)
    check_format(document)
    document.read(_Manifest)
    return dict(document.content)


def shard_bytes(table: pa.Table) -> bytes:
    """The content of the file of a shard."""
    sink = io.BytesIO()
    pq.write_table(table, sink, compression="zstd", use_dictionary=False, write_statistics=False)
    return sink.getvalue()


class SweepFolder:
    """The folder of one sweep, from which finished shards are never lost.

    Every file appears whole or not at all, and only this process writes.

    Attributes:
        path: the folder.
    """

    def __init__(self, path: Path, plan: Plan) -> None:
        """A folder for the shards of a plan; nothing is written yet."""
        self.path = path
        self._plan = plan
        self._manifest: dict[str, Any] = {}

    def check(self, *, resume: bool) -> None:
        """Raises OctarmError if the folder holds something else, or a sweep that may not go on.

        Args:
            resume: whether the same sweep, begun there, may go on.
        """
        if self.path.exists() and not self.path.is_dir():
            raise OctarmError(f"{self.path} is not a folder; choose another --out")
        entries = self.path.iterdir() if self.path.exists() else ()
        names = {entry.name for entry in entries}
        if MANIFEST not in names:
            if names - {_LOCK, PROGRESS, SPEC, EPISODES}:
                raise OctarmError(f"{self.path} exists and is not a sweep; choose another --out")
            return
        if not resume:
            raise OctarmError(
                f"{self.path} holds a sweep already; go on with it by --resume, or choose another "
                "--out"
            )
        before, now = read_manifest(self.path)["spec"], self._plan.spec.content()
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
        lock = filelock.FileLock(self.path / _LOCK, timeout=0)
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

    def begin(self, gains: Mapping[str, Any]) -> list[str]:
        """Writes what the sweep is, or notes that it goes on.

        Args:
            gains: of each controller; they may not change.

        Returns:
            Which versions have changed since it was begun, a sentence each.
        """
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        start: dict[str, Any] = {"time": now, "versions": versions(), "host": host()}
        if (self.path / MANIFEST).exists():
            self._manifest = read_manifest(self.path)
            for name, values in gains.items():
                if self._manifest["gains"].get(name) != values:
                    raise OctarmError(
                        f"{self.path} was begun with other gains of {name}: this version "
                        "recommends others"
                    )
        else:
            spec, plan = self._plan.spec, self._plan
            self._manifest = {
                "format": FORMAT,
                "spec": spec.content(),
                "spec_hash": spec.hash(),
                "episodes": plan.episodes,
                "gains": gains,
                "starts": [],
                "shards": [
                    {
                        "file": f"{EPISODES}/{i:05d}.parquet",
                        "first": episodes.start,
                        "episodes": len(episodes),
                        "sha256": "",  # of a shard that is not finished
                    }
                    for i, episodes in enumerate(plan.shards)
                ],
            }
            whole = spec.text and parse_spec(spec.text) == spec
            write_text(self.path / SPEC, spec.text if whole else spec.to_toml())
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
        return [
            i
            for i, shard in enumerate(self._manifest["shards"])
            if _is_whole(_content(self.path / shard["file"]), shard)
        ]

    def write(self, shard: int, table: pa.Table) -> None:
        """Writes a shard, and what the manifest says of it."""
        entry, content = self._manifest["shards"][shard], shard_bytes(table)
        with whole_file(self.path / entry["file"]) as part:
            part.write_bytes(content)
            entry["sha256"] = hashlib.sha256(content).hexdigest()
            self._write_manifest()

    def _write_manifest(self) -> None:
        write_text(self.path / MANIFEST, to_json(self._manifest))


def _shards(
    folder: Path, *, episode: int | None = None, columns: Sequence[str] | None = None
) -> Iterator[tuple[int, pa.Table]]:
    """The finished shards, or that of an episode: the first episode and the rows of each."""
    empty = True
    for shard in read_manifest(folder)["shards"]:
        file, first = folder / shard["file"], shard["first"]
        if episode is not None and not first <= episode < first + shard["episodes"]:
            continue
        content = _content(file)
        if content is None or not shard["sha256"]:
            continue
        if not _is_whole(content, shard):
            raise OctarmError(
                f"{file} is damaged: it does not have the SHA-256 that {MANIFEST} states; "
                "--resume runs it again"
            )
        empty = False
        yield first, _table(file, content, columns)
    if empty and episode is None:
        raise OctarmError(f"{folder} has no finished episode yet")
    if empty:
        raise OctarmError(f"episode {episode} of {folder} is not finished; --resume runs it")


def _table(file: Path, content: bytes, columns: Sequence[str] | None) -> pa.Table:
    """Columns of a shard, all if None; raises OctarmError if the bytes are no table with them."""
    try:
        with pq.ParquetFile(pa.BufferReader(content)) as stored:
            known = stored.schema_arrow.names
            for name in columns or ():
                if name not in known:
                    raise OctarmError(f"{file} has no column {quoted(name)}{closest(name, known)}")
            # Without threads: one that ends after the interpreter aborts the process when it frees
            # a buffer that is Python's.
            names = None if columns is None else [*columns]
            return stored.read(columns=names, use_threads=False)
    except (pa.ArrowException, OSError) as error:  # of Arrow, which has them from no system call
        if isinstance(error, OctarmError | MemoryError):
            raise
        raise OctarmError(f"{file} is damaged: {error}") from None


def _content(file: Path) -> bytes | None:
    """The bytes of a file; None if there is none."""
    try:
        return file.read_bytes()
    except FileNotFoundError:
        return None
    except OSError as error:
        raise FileError(f"{file} cannot be read: {error.strerror}") from None


def _is_whole(content: bytes | None, shard: Mapping[str, Any]) -> bool:
    return content is not None and hashlib.sha256(content).hexdigest() == shard["sha256"]

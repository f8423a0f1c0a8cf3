"""A sweep on disk: `spec.toml`, `manifest.json` and `episodes/*.parquet`, one file a shard."""

from __future__ import annotations

import contextlib
import datetime
import io
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from octarm.facts import host, versions
from octarm.files import whole_file, write_text
from octarm.sweeps.parser import as_toml, parse_spec
from octarm.sweeps.plan import Plan
from octarm.sweeps.spec import SweepSpec

SPEC = "spec.toml"
MANIFEST = "manifest.json"
EPISODES = "episodes"
_LOCK = ".lock"


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
        self._hash = plan.spec.hash()

    def check(self, *, resume: bool) -> None:
        """Looks at what is there, and changes nothing.

        Args:
            resume: whether a sweep that was begun there may go on.

        Raises:
            ValueError: if the folder holds something else, or a sweep that may not go on.
        """
        if self.path.exists() and not self.path.is_dir():
            raise ValueError(f"{self.path} is not a folder; choose another --out")
        found = {entry.name for entry in self.path.iterdir()} if self.path.exists() else set()
        if not found & {MANIFEST} and found - {_LOCK, SPEC, EPISODES}:
            raise ValueError(f"{self.path} exists and is not a sweep; choose another --out")
        if MANIFEST not in found:
            return
        if not resume:
            raise ValueError(
                f"{self.path} holds a sweep already; go on with it by --resume, or choose another "
                "--out"
            )
        before, now = read_manifest(self.path)["spec"], self._plan.spec.content()
        for key in (*before, *now):
            if before.get(key) != now.get(key):
                old, new = (_told(content, key) for content in (before, now))
                raise ValueError(
                    f"{self.path} was begun with another spec: {key} {old} there and {new} here"
                )

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Makes the folder, and keeps other processes from writing there.

        Raises:
            ValueError: if another one does.
            OSError: if it cannot be written.
        """
        try:
            (self.path / EPISODES).mkdir(parents=True, exist_ok=True)
            file = open(self.path / _LOCK, "w")
        except OSError as error:
            raise OSError(f"{self.path} cannot be written: {error.strerror}") from None
        with file:
            try:
                _lock(file.fileno())
            except BlockingIOError:
                raise ValueError(f"another process is at work on {self.path}") from None
            yield

    def begin(self, gains: Mapping[str, Any]) -> list[str]:
        """Writes what the sweep is, or notes that it goes on.

        Args:
            gains: of each controller.

        Returns:
            Which versions have changed since it was begun, a sentence each.

        Raises:
            ValueError: if controllers have other gains than when it was begun.
            OSError: if it cannot be written.
        """
        start = {"time": _now(), "versions": versions(), "host": host()}
        if (self.path / MANIFEST).exists():
            before = read_manifest(self.path)
            for name, own in gains.items():
                if before["gains"].get(name) != own:
                    raise ValueError(
                        f"{self.path} was begun with other gains of {name}: this version "
                        "recommends others"
                    )
            starts = [*before["starts"], start]
        else:
            starts = [start]
            write_text(self.path / SPEC, _spec_text(self._plan.spec))
        shards = [
            {"file": f"{EPISODES}/{shard_name(i)}", "first": s.start, "episodes": len(s)}
            for i, s in enumerate(self._plan.shards)
        ]
        manifest = {
            "spec": self._plan.spec.content(),
            "spec_hash": self._hash,
            "episodes": self._plan.episodes,
            "gains": gains,
            "starts": starts,
            "shards": shards,
        }
        write_text(self.path / MANIFEST, _json(manifest))
        return _changes(starts[0]["versions"], start["versions"])

    def finished(self) -> list[int]:
        """The shards that are there, readable, and of the right episodes."""
        return [i for i, episodes in enumerate(self._plan.shards) if self._is_whole(i, episodes)]

    def write(self, shard: int, table: pa.Table) -> None:
        """Writes a shard.

        Raises:
            OSError: if it cannot be written.
        """
        file = self._file(shard)
        labels = {**(table.schema.metadata or {}), b"spec": self._hash.encode()}
        content = parquet_bytes(table.replace_schema_metadata(labels))
        with whole_file(file) as part:
            part.write_bytes(content)

    def _file(self, shard: int) -> Path:
        return self.path / EPISODES / shard_name(shard)

    def _is_whole(self, shard: int, episodes: range) -> bool:
        """Whether a shard can be taken as it is; a damaged one is run again."""
        file = self._file(shard)
        if not file.is_file():
            return False
        try:
            table = pq.read_table(file, page_checksum_verification=True)
        except (OSError, ValueError):
            return False
        labels = table.schema.metadata or {}
        return labels.get(b"spec") == self._hash.encode() and table.column(
            "episode"
        ).to_pylist() == list(episodes)


def read_sweep(folder: str | Path, columns: Sequence[str] | None = None) -> pa.Table:
    """The finished episodes of a sweep, a row each, in the order of their numbers.

    Args:
        folder: of the sweep.
        columns: names of those to read; all when not given. Metadata of a field holds its `unit`.

    Raises:
        ValueError: if the folder holds no sweep, no finished shard or a damaged one.
    """
    folder = Path(folder)
    files = [folder / shard["file"] for shard in read_manifest(folder)["shards"]]
    names = None if columns is None else list(columns)
    tables = []
    for file in files:
        if file.is_file():
            try:
                tables.append(pq.read_table(file, columns=names, page_checksum_verification=True))
            except (OSError, ValueError) as error:
                raise ValueError(f"{file} is damaged ({error}); --resume runs it again") from None
    if not tables:
        raise ValueError(f"{folder} has no finished episode yet")
    return pa.concat_tables(table.replace_schema_metadata(None) for table in tables)


def read_facts(folder: str | Path, episode: int) -> dict[str, Any]:
    """Where and with which versions an episode was run: `host` and `versions`.

    Raises:
        ValueError: if the folder holds no sweep, or the episode is not finished.
    """
    for shard in read_manifest(Path(folder))["shards"]:
        file = Path(folder) / shard["file"]
        if 0 <= episode - shard["first"] < shard["episodes"] and file.is_file():
            labels = pq.read_schema(file).metadata
            return {key: json.loads(labels[key.encode()]) for key in ("host", "versions")}
    raise ValueError(f"episode {episode} is not in {folder}")


def read_manifest(folder: Path) -> dict[str, Any]:
    """What `manifest.json` says.

    Raises:
        ValueError: if the folder holds no sweep.
    """
    file = folder / MANIFEST
    try:
        manifest = json.loads(file.read_text(encoding="utf-8"))
    except (FileNotFoundError, NotADirectoryError):
        raise ValueError(f"{folder} is not a sweep: it has no {MANIFEST}") from None
    except ValueError as error:
        raise ValueError(f"{file} is not readable ({error})") from None
    missing = {"spec", "gains", "starts", "shards"} - set(
        manifest if isinstance(manifest, dict) else ()
    )
    if missing:
        raise ValueError(f"{file} does not describe a sweep: it lacks {', '.join(sorted(missing))}")
    return manifest


def shard_name(shard: int) -> str:
    """The file of a shard."""
    return f"{shard:05d}.parquet"


def parquet_bytes(table: pa.Table) -> bytes:
    """A table as the content of a Parquet file."""
    sink = io.BytesIO()
    pq.write_table(
        table,
        sink,
        compression="zstd",
        use_dictionary=False,
        write_statistics=False,
        write_page_checksum=True,
    )
    return sink.getvalue()


def _spec_text(spec: SweepSpec) -> str:
    """The file that the spec was read from, or one that says the same if it was changed since."""
    if spec.text and parse_spec(spec.text) == spec:
        return spec.text
    return as_toml(spec)


def _json(manifest: Mapping[str, Any]) -> str:
    """JSON with a line for each entry of each table or list."""
    tables = []
    for key, value in manifest.items():
        text = json.dumps(value)
        if isinstance(value, Mapping) and value:
            rows = [f"  {json.dumps(k)}: {json.dumps(v)}" for k, v in value.items()]
            text = "{\n" + ",\n".join(rows) + "\n }"
        elif isinstance(value, list) and value:
            text = "[\n" + ",\n".join(f"  {json.dumps(item)}" for item in value) + "\n ]"
        tables.append(f" {json.dumps(key)}: {text}")
    return "{\n" + ",\n".join(tables) + "\n}\n"


def _now() -> str:
    return datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")


def _changes(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Versions that have changed since the sweep was begun."""
    return [
        f"{name} was {before.get(name, 'absent')} when the sweep was begun and is {now[name]} now"
        for name in now
        if name != "platform" and before.get(name) != now[name]
    ]


def _told(content: Mapping[str, Any], key: str) -> str:
    return f"is {json.dumps(content[key])}" if key in content else "is not given"


def _lock(descriptor: int) -> None:
    """Takes the lock of an open file, where the system has such a thing.

    Raises:
        BlockingIOError: if another process has it.
    """
    try:
        import fcntl
    except ImportError:  # Windows
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        raise
    except OSError:  # some network file systems have no locks
        return

"""The folder that a sweep is written to."""

from __future__ import annotations

import contextlib
import datetime
import json
from collections.abc import Generator, Mapping
from pathlib import Path
from typing import Any, cast

import pyarrow as pa

from octarm.errors import FileError, OctarmError
from octarm.files import write_text
from octarm.runs.versions import host, versions
from octarm.sweeps.folder import (
    EPISODES,
    MANIFEST,
    SPEC,
    is_shard,
    labels,
    read_manifest,
    shard_name,
)
from octarm.sweeps.parser import parse_spec
from octarm.sweeps.plan import Plan
from octarm.sweeps.shard_file import read_shard, write_shard
from octarm.sweeps.spec import SweepSpec
from octarm.sweeps.spelling import as_toml
from octarm.sweeps.under_way import Notes

_LOCK = ".lock"
_UNDER_WAY = ".under-way"


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
            raise OctarmError(f"{self.path} is not a folder; choose another --out")
        there = self.path.iterdir() if self.path.exists() else ()
        found = {entry.name for entry in there}
        if not found & {MANIFEST} and found - {_LOCK, _UNDER_WAY, SPEC, EPISODES}:
            raise OctarmError(f"{self.path} exists and is not a sweep; choose another --out")
        if MANIFEST not in found:
            return
        if not resume:
            raise OctarmError(
                f"{self.path} holds a sweep already; go on with it by --resume, or choose another "
                "--out"
            )
        before, now = read_manifest(self.path)["spec"], self._plan.spec.content()
        for key in (*before, *now):
            if before.get(key) != now.get(key):
                old, new = (_told(content, key) for content in (before, now))
                raise OctarmError(
                    f"{self.path} was begun with another spec: {key} {old} there and {new} here"
                )

    @contextlib.contextmanager
    def locked(self) -> Generator[None]:
        """Makes the folder, and keeps other processes from writing there.

        Raises:
            ValueError: if another one does.
            OSError: if it cannot be written.
        """
        try:
            (self.path / EPISODES).mkdir(parents=True, exist_ok=True)
            file = open(self.path / _LOCK, "w")
        except OSError as error:
            raise FileError(f"{self.path} cannot be written: {error.strerror}") from None
        with file:
            try:
                _lock(file.fileno())
            except BlockingIOError:
                raise OctarmError(f"another process is at work on {self.path}") from None
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
        start: dict[str, Any] = {"time": _now(), "versions": versions(), "host": host()}
        if (self.path / MANIFEST).exists():
            before = read_manifest(self.path)
            for name, own in gains.items():
                if before["gains"].get(name) != own:
                    raise OctarmError(
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
        own = labels(self._hash, self._plan.shards[shard].start)
        write_shard(self._file(shard), table, own)

    def notes(self) -> Notes:
        """Where it is noted how far the shards under way are."""
        return Notes(self.path.resolve() / _UNDER_WAY)

    def _file(self, shard: int) -> Path:
        return self.path / EPISODES / shard_name(shard)

    def _is_whole(self, shard: int, episodes: range) -> bool:
        """Whether a shard can be taken as it is; a damaged one is run again."""
        file = self._file(shard)
        try:
            table = read_shard(file, ["episode"])
        except (OSError, ValueError):
            return False
        return is_shard(table, self._hash, episodes)


def _spec_text(spec: SweepSpec) -> str:
    """The file that the spec was read from, or one that says all if that one does not."""
    if spec.text and spec.alone and parse_spec(spec.text) == spec:
        return spec.text
    return as_toml(spec)


def _json(manifest: Mapping[str, Any]) -> str:
    """JSON with a line for each entry of each table or list."""
    tables: list[str] = []
    for key, value in manifest.items():
        text = json.dumps(value)
        if isinstance(value, Mapping) and value:
            table = cast(Mapping[str, Any], value)
            rows = [f"  {json.dumps(k)}: {json.dumps(v)}" for k, v in table.items()]
            text = "{\n" + ",\n".join(rows) + "\n }"
        elif isinstance(value, list) and value:
            rows = [f"  {json.dumps(item)}" for item in cast(list[Any], value)]
            text = "[\n" + ",\n".join(rows) + "\n ]"
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

"""What `manifest.json` says of a sweep, and whether it may be believed.

It holds the SHA-256 of `spec.toml` and of every finished shard: from it hashes chain to every byte.
All that the spec decides has to be what the spec decides, so that nothing is missing, doubled or in
another order. A shard and its SHA-256 that were changed together are found by `octarm verify`
alone, which runs episodes again.
"""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, cast

from octarm.errors import OctarmError
from octarm.files import read_bytes
from octarm.formats import FORMAT, check_format, read_json, spelt
from octarm.sweeps.plan import Plan
from octarm.sweeps.spec import hash_of
from octarm.sweeps.spec_file import parse_spec

SPEC = "spec.toml"
MANIFEST = "manifest.json"
EPISODES = "episodes"

_KEYS = (
    "format", "spec", "spec_hash", "spec_sha256", "episodes", "gains", "starts", "shards",
)  # fmt: skip
_START = {"time", "versions", "host"}
_SUM = re.compile(r"[0-9a-f]{64}|")  # empty for a shard that is not finished


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
        "shards": [{**shard, "sha256": ""} for shard in _shards(plan)],
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
    manifest = dict(document.content)
    if missing := [key for key in _KEYS if key not in manifest]:
        raise OctarmError(f"{file} does not describe a sweep: it lacks {', '.join(missing)}")
    if unknown := [key for key in manifest if key not in _KEYS]:
        raise OctarmError(f"{file} was changed: it has the unknown key {spelt(unknown[0])}")
    plan = _plan(folder / SPEC, manifest["spec_sha256"])
    for problem in _problems(manifest, plan):
        raise OctarmError(f"{file} was changed: {problem}")
    return plan, manifest


def _plan(file: Path, sha256: Any) -> Plan:
    """The plan of `spec.toml`, which has to be the file that the sweep was begun with."""
    content = read_bytes(file)
    if hashlib.sha256(content).hexdigest() != sha256:
        raise OctarmError(
            f"{file} was changed: it is not what the sweep was run with, or {MANIFEST} was changed"
        )
    return Plan(parse_spec(content.decode("utf-8", "replace"), str(file)))


def _problems(manifest: Mapping[str, Any], plan: Plan) -> Iterator[str]:
    """What a manifest says that is not what the plan says, or cannot be, a few words each."""
    spec = plan.spec.content()
    if manifest["spec"] != spec or manifest["spec_hash"] != hash_of(manifest["spec"]):
        yield f"spec and spec_hash are not those of {SPEC}"
    if repr(manifest["episodes"]) != repr(plan.episodes):
        yield f"episodes is {spelt(manifest['episodes'])}; by {SPEC} it is {plan.episodes}"
    gains, starts, shards = (manifest[key] for key in ("gains", "starts", "shards"))
    if not isinstance(gains, dict) or {*gains} != {*plan.spec.controllers}:
        yield f"gains are not those of {', '.join(plan.spec.controllers)}"
    if not (isinstance(starts, list) and starts and all(map(_is_start, cast(list[Any], starts)))):
        yield "starts must hold the time, the versions and the host of each start"
    expected = _shards(plan)
    if not isinstance(shards, list) or len(cast(list[Any], shards)) != len(expected):
        yield f"shards must be a list of {len(expected)}"
        return
    for shard, right in zip(cast(list[dict[str, Any]], shards), expected, strict=True):
        sha256 = shard.get("sha256") if isinstance(cast(Any, shard), dict) else None
        if not isinstance(sha256, str) or not _SUM.fullmatch(sha256):
            yield f"{right['file']} has no SHA-256 but {spelt(sha256)}"
        elif repr(shard) != repr({**right, "sha256": sha256}):
            yield f"a shard is {spelt(shard)}; by {SPEC} it is {spelt(right)}"


def _is_start(start: Any) -> bool:
    if not isinstance(start, dict) or {*cast(dict[str, Any], start)} != _START:
        return False
    return isinstance(start["time"], str) and all(
        isinstance(start[key], dict) for key in ("versions", "host")
    )


def _shards(plan: Plan) -> list[dict[str, Any]]:
    return [
        {"file": f"{EPISODES}/{i:05d}.parquet", "first": each.start, "episodes": len(each)}
        for i, each in enumerate(plan.shards)
    ]

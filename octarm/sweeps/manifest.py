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
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from octarm.errors import OctarmError
from octarm.files import read_bytes
from octarm.formats import FORMAT, Array, Model, check_format, read_json
from octarm.sweeps.plan import Plan
from octarm.sweeps.spec_file import parse_spec

SPEC = "spec.toml"
MANIFEST = "manifest.json"
EPISODES = "episodes"


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
        "shards": [_new_shard(i, plan.shard(i)) for i in plan.shards],
        "starts": [],
    }


def _new_shard(i: int, episodes: range) -> dict[str, Any]:
    file = f"{EPISODES}/{i:05d}.parquet"
    return {"file": file, "first": episodes.start, "episodes": len(episodes), "sha256": ""}


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

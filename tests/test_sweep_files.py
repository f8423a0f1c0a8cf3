"""The shards of a sweep come back as they were written, or not at all."""

import itertools
import json
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from test_sweep import Inline

import octarm
from controllers import make_controller
from octarm.errors import OctarmError
from octarm.sweeps.spec_file import parse_spec
from octarm.sweeps.store import open_sweep, read_shard

SPEC = 'controller = "pd"\nduration = 0.002\nepisodes = 2\nbatch = 1'


@pytest.fixture(scope="module")
def original(tmp_path_factory) -> tuple[dict[str, bytes], pa.Table]:
    folder = tmp_path_factory.mktemp("original") / "s"
    octarm.sweep(parse_spec(SPEC), make_controller, folder, executor=Inline(), in_flight=1)
    files = {str(f.relative_to(folder)): f.read_bytes() for f in folder.rglob("*") if f.is_file()}
    return files, octarm.read_sweep(folder)


@pytest.fixture
def folder(original, tmp_path) -> Path:
    for name, content in original[0].items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(content)
    return tmp_path


def test_a_shard_is_a_parquet_file_like_any_other(folder, original):
    table = original[1]
    assert pq.read_table(folder / "episodes/00001.parquet").equals(table.slice(1, 1))
    assert octarm.read_sweep(folder, ["effort_tau1"]).equals(table.select(["effort_tau1"]))
    with pytest.raises(ValueError, match="no column 'efort_tau1', did you mean 'effort_tau1'"):
        octarm.read_sweep(folder, ["efort_tau1"])


def test_a_bit_that_is_flipped_is_noticed_wherever_it_is(folder):
    """Every seventh byte, by what reads a shard; some of them by what reads a sweep."""
    file = folder / "episodes/00001.parquet"
    content = file.read_bytes()
    damaged = bytearray(content)
    plan, manifest = open_sweep(folder)
    for count, place in enumerate(range(0, len(content), 7)):
        bit = 1 << place % 8
        damaged[place] ^= bit
        file.write_bytes(damaged)
        damaged[place] ^= bit
        columns = ["effort_tau1"] if place % 2 else None
        with pytest.raises(OctarmError, match=r"00001\.parquet is damaged"):
            if count % 100:
                read_shard(folder, plan, manifest, 1, columns)
            else:
                octarm.read_sweep(folder, columns)


def test_any_piece_that_is_lost_or_added_is_noticed(folder):
    file = folder / "episodes/00001.parquet"
    content = file.read_bytes()
    cuts = itertools.chain(range(0, len(content), 500), range(len(content) - 20, len(content)))
    other = (folder / "episodes/00000.parquet").read_bytes()
    pieces = (content[:cut] for cut in cuts)
    for broken in (*pieces, content[1:], content + b"\n", content * 2, other):
        file.write_bytes(broken)
        with pytest.raises(ValueError, match="is damaged"):
            octarm.read_sweep(folder)


def test_a_file_that_the_manifest_does_not_know_is_not_taken(folder):
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["shards"][1]["sha256"] = ""  # as if it was never finished
    (folder / "manifest.json").write_text(json.dumps(manifest))
    assert len(octarm.read_sweep(folder)) == 1


def test_a_sweep_of_another_format_is_refused(folder):
    manifest = open_sweep(folder)[1]
    assert manifest["format"] == 3
    for version in (2, 4):
        (folder / "manifest.json").write_text(json.dumps({**manifest, "format": version}))
        with pytest.raises(ValueError, match=rf"manifest.json has format {version}; this version"):
            octarm.read_sweep(folder)

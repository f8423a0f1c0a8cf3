"""Runs of any length: blocks of rows on disk, and the loop that holds none of them."""

import contextlib
import dataclasses
import errno
import os
import shutil
import signal
import sys
import tracemalloc
from typing import NamedTuple

import numpy as np
import pytest
from recordings import part_of, swinging

from controllers import make_controller
from octarm.arm.mjcf import nominal_parameters
from octarm.interfaces import Rows
from octarm.runs.folder import Archive, read_blocks
from octarm.simulation.environment import load
from octarm.simulation.rollout import ArmRecorder, copied, rollout
from octarm.simulation.trajectory import Ending, Trajectory, joined

ODD = {
    "a name/with: +é": np.ones((230, 2)),
    "none": np.ones((230, 0)),
    "rules": np.ones((230, 6, 5)),
}


@contextlib.contextmanager
def archived(path, run, *, block=100, expected=None):
    """An archive of a run, filled block by block."""
    with Archive(path, rows=expected or len(run)) as archive:
        for k in range(0, len(run), block):
            archive.add(dict(part_of(run, k, k + block).arrays()), run.layer)
        yield archive


def same(one: Trajectory, other: Trajectory) -> None:
    for (name, array), (its_name, its) in zip(one.arrays(), other.arrays(), strict=True):
        assert name == its_name
        np.testing.assert_array_equal(array, its)
        assert array.dtype == np.float64 and not array.flags.writeable
    np.testing.assert_array_equal(one.layer, other.layer)


@pytest.mark.parametrize("layer", [None, np.arange(6.0)])
@pytest.mark.parametrize("rows", [1, 100, 230])
def test_the_arrays_are_the_bytes_that_a_trajectory_saves(tmp_path, rows, layer):
    run = part_of(swinging(rows=230, **ODD), 0, rows)
    run = dataclasses.replace(run, status="diverged", message="too far", layer=layer)
    with archived(tmp_path / "blocks", run) as archive:
        archive.save(tmp_path / "a.npz", Ending(layer, "diverged", "too far", run.digest))
    run.save(tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()
    assert not (tmp_path / "blocks").exists()


def test_a_mapped_run_is_the_run(tmp_path):
    run = dataclasses.replace(swinging(rows=230, **ODD), layer=np.arange(6.0))
    run.save(tmp_path / "a.npz")
    again = Trajectory.load(tmp_path / "a.npz", mapped=True)
    same(run, again)
    assert (again.status, again.digest) == (run.status, run.digest)
    arrays = dict(np.load(tmp_path / "a.npz", allow_pickle=False))
    np.savez_compressed(tmp_path / "b.npz", **arrays)
    same(run, Trajectory.load(tmp_path / "b.npz", mapped=True))


@pytest.mark.parametrize("damage", ["nonsense", "flipped", "short", "other", "objects", "words"])
def test_a_damaged_file_is_no_trajectory(tmp_path, damage):
    path = tmp_path / "a.npz"
    swinging(rows=230).save(path)
    content = bytearray(path.read_bytes())
    if damage == "flipped":
        content[5000] ^= 1
    path.write_bytes({"nonsense": b"x", "short": content[:9000]}.get(damage, content))
    if damage == "other":
        np.savez(path, x=np.ones(3))
    if damage in ("objects", "words"):
        arrays = dict(np.load(path, allow_pickle=False))
        arrays["s"] = np.full(230, None) if damage == "objects" else np.full(230, "word")
        np.savez(path, **arrays)
    with pytest.raises(ValueError, match=r"a\.npz is (not a trajectory file|damaged)"):
        Trajectory.load(path, mapped=True)


def test_blocks_can_be_read_when_nobody_closed_them(tmp_path):
    run = dataclasses.replace(swinging(rows=230, **ODD), layer=np.arange(6.0))
    path = tmp_path / "left"
    with archived(tmp_path / "blocks", run):
        shutil.copy(tmp_path / "blocks", path)
    left = read_blocks(path)
    same(run, left)
    assert (left.status, left.message) == ("interrupted", "killed after t = 0.229 s")
    os.truncate(path, os.path.getsize(path) - 1)  # amid a block
    same(dataclasses.replace(part_of(run, 0, 200), layer=run.layer), read_blocks(path))
    for content in (b"", b"{}\n", path.read_bytes()[:3000]):
        path.write_bytes(content)
        with pytest.raises(ValueError, match="left holds no rows"):
            read_blocks(path)


def test_rows_that_find_no_room_are_refused_at_the_first_block(tmp_path, monkeypatch):
    class Usage(NamedTuple):
        free: int

    monkeypatch.setattr(shutil, "disk_usage", lambda _: Usage(10_000_000))
    sentence = r"blocks cannot be written: so many rows take .* GB on disk, of which 0\.01 GB are"
    blocks = archived(tmp_path / "blocks", swinging(rows=230), expected=10**9)
    with pytest.raises(OSError, match=sentence), blocks:
        pass


@pytest.mark.skipif(sys.platform != "linux", reason="/dev/full is a Linux device")
def test_a_full_disk_and_an_unwritable_place_are_one_sentence(tmp_path):
    (tmp_path / "blocks").symlink_to("/dev/full")
    for place, reason in ("blocks", errno.ENOSPC), ("folder/blocks", errno.ENOENT):
        sentence = rf"blocks cannot be written: {os.strerror(reason)}$"
        blocks = archived(tmp_path / place, swinging(rows=230))
        with pytest.raises(OSError, match=sentence), blocks:
            pass


def begun(duration=1.0):
    arm = nominal_parameters()
    return load(duration=duration), make_controller("smc-boundary", arm.mismatched(-0.3))


@pytest.mark.parametrize("block", [7, 20, 1000])
def test_a_run_in_blocks_is_the_run_in_memory(block):
    environment, controller = begun()
    blocks: list[Rows] = []
    recorder = ArmRecorder(environment, lambda rows: blocks.append(copied(rows)), rows=block)
    ending = recorder.run(controller, 0.02)
    whole = rollout(environment, controller, 0.02)
    same(whole, joined(blocks, ending))
    assert (ending.status, ending.message, ending.digest) == ("ok", "", whole.digest)
    full, rest = divmod(40, block)
    assert [len(rows["t"]) for rows in blocks] == [block] * full + [rest] * bool(rest)


def test_the_memory_a_run_takes_does_not_grow_with_it():
    environment, controller = begun()
    peaks = []
    for duration in (0.02, 0.02, 0.4):  # the first one fills caches
        tracemalloc.start()
        ArmRecorder(environment, len, rows=20).run(controller, duration)
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
    assert peaks[2] < peaks[1] + 20_000  # 760 rows more are 300 kB


@pytest.mark.skipif(os.name != "posix", reason="signals as on POSIX")
def test_an_interrupted_run_has_whole_blocks():
    environment, controller = begun()
    blocks: list[Rows] = []

    def keep(rows: Rows) -> None:
        if len(blocks) == 1:
            signal.raise_signal(signal.SIGINT)
        blocks.append(copied(rows))

    ending = ArmRecorder(environment, keep, rows=10).run(controller, 0.5)
    assert ending.status == "interrupted" and "interrupted at t = 0.01 s" in ending.message
    whole = rollout(environment, controller, 0.01)
    same(whole, joined(blocks, ending))
    assert ending.digest == whole.digest

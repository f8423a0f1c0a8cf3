"""The commands that look at runs, and what an interrupted run leaves."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import rerun as rr
from recordings import described, fields, swinging, write_run

import octarm
from octarm.commands import cli
from octarm.commands import replay as replay_commands
from octarm.recordings import viewer
from octarm.recordings.recording import write_recording
from octarm.runs import folder as runs

posix = pytest.mark.skipif(os.name != "posix", reason="signals as on POSIX")


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def opened(monkeypatch):
    """The recordings that the viewer was given, as their names and entities."""
    found = []

    def note(paths):
        for path in paths:
            found.append(
                (Path(path).name, {c.entity_path for c in rr.chunk.RrdReader(path).stream()})
            )

    monkeypatch.setattr(viewer, "open_viewer", note)
    return found


def folder(name, run=None, **more):
    """A run folder without a recording."""
    Path(name).mkdir()
    write_run(Path(name), run or swinging(rows=300), described(**more))
    return Path(name)


def test_record_rebuilds_what_the_run_recorded():
    assert cli.main(["run", "--controller", "afsmc", "--disturbance", "noise:0.1",
                     "--duration", "0.6", "--out", "a"]) == 0  # fmt: skip
    assert cli.main(["record", "a", "--out", "again.rrd"]) == 0
    for entity in ("/signals", "/adaptation"):
        first, second = fields("a/run.rrd", entity), fields("again.rrd", entity)
        assert first.keys() == second.keys()
        for name in first:
            np.testing.assert_array_equal(first[name], second[name])
    both = [contents(path) for path in ("a/run.rrd", "again.rrd")]
    assert both[0].keys() == both[1].keys()
    for key in both[0]:
        assert repr(both[0][key]) == repr(both[1][key]), key  # NaN included


def contents(path):
    """All that a recording holds but ids: last static values, and rows in the order of time."""
    found = {}
    for chunk in rr.chunk.RrdReader(path).stream():
        batch = chunk.to_record_batch()
        kept = [name for name in batch.schema.names if not name.startswith("rerun.controls")]
        for name in kept:
            key, values = (chunk.entity_path, name), batch.column(name).to_pylist()
            if chunk.is_static:
                found[key] = values
            else:
                found.setdefault(key, []).extend(values)
    return found


def test_two_runs_are_shown_as_one(opened):
    folder("a")
    folder("b")
    assert cli.main(["replay", "a", "b"]) == 0
    ((name, entities),) = opened
    assert name == "comparison.rrd"
    assert {"/A/world/tube", "/B/world/tube", "/difference"} <= entities


def test_a_sweep_shows_its_recorded_episodes(opened, capsys):
    Path("sweep").mkdir()
    Path("sweep/manifest.json").write_text("{}")
    assert cli.main(["replay", "sweep"]) == 2
    assert "without recorded episodes" in capsys.readouterr().err
    Path("sweep/recorded").mkdir()
    for name in ("7-worst", "3-median"):
        cli.main(["record", str(folder(f"sweep/recorded/{name}"))])
    assert cli.main(["replay", "sweep"]) == 0
    assert [name for name, _ in opened] == ["0-3-median.rrd", "1-7-worst.rrd"]
    assert all("/world/tube" in entities for _, entities in opened)


def test_each_episode_has_a_layout_of_its_own_and_a_name_that_the_viewer_takes(tmp_path):
    names = ("worst: pd, noise 40 %", "worst: smc, noise 40 %", "")
    applications: list[str] = []
    for name in names:
        path = tmp_path / "run.rrd"
        write_recording(path, swinging(rows=20), described(), name=name)
        (store,) = rr.chunk.RrdReader(path).recordings()
        applications.append(store.application_id)
    assert applications == ["worst: pd noise 40", "worst: smc noise 40", "octarm"]


def test_what_cannot_be_shown_is_refused(capsys):
    folder("a")
    for arguments, message in (
        (["replay"], "0 runs are given"),
        (["replay", "a", "a", "a"], "3 runs are given"),
        (["replay", "a"], "a has no recording run.rrd; octarm record writes one"),
        (["replay", "nothing"], "nothing is not a run folder"),
        (["replay", "a", "--web", "--screenshot", "x.png"], "exclude each other"),
        (["record", "nothing"], "nothing is not a run folder"),
    ):
        assert cli.main(arguments) == 2
        assert message in capsys.readouterr().err
    Path("a/run.npz").unlink()
    for command in ("record", "plot"):
        assert cli.main([command, "a"]) == 2
        assert "a has no run.npz: it is incomplete" in capsys.readouterr().err


def test_the_figures_are_written_beside_the_run():
    folder("a")
    assert cli.main(["plot", "a"]) == 0
    assert {p.name for p in Path("a").iterdir()} == {"run.npz", "run.json"}
    assert Path("a-figures/tracking.svg").is_file()


def started(*options):
    """A long run as a process of its own, once it has recorded something."""
    command = [
        sys.executable,
        "-m",
        "octarm",
        "run",
        "--duration",
        "600",
        "--out",
        "a",
    ]
    process = subprocess.Popen([*command, *options], stdout=-3, stderr=subprocess.PIPE, text=True)
    part = Path("a") / runs.PARTIAL
    while not (part.is_file() and part.stat().st_size > 500_000):  # a block has 1 MB
        assert process.poll() is None
        time.sleep(0.05)
    time.sleep(0.3)  # so that it is whole
    return process


@pytest.mark.slow
@posix
def test_an_interrupted_run_is_kept_and_said_to_be_partial(opened, capsys):
    process = started()
    process.terminate()
    process.send_signal(signal.SIGINT)  # of somebody who is in a hurry
    _, err = process.communicate(timeout=1800)
    run, description = octarm.read_run("a")
    assert process.returncode == 130
    assert err == f"octarm: interrupted; a holds the run up to t = {run.t[-1]:.6g} s\n"
    assert run.status == description["status"] == "interrupted"
    assert len(run) >= 5000
    assert {p.name for p in Path("a").iterdir()} == {"run.npz", "run.json", "run.rrd"}
    np.testing.assert_array_equal(fields("a/run.rrd", "/signals")["tau"], run.tau)
    assert cli.main(["replay", "a"]) == 0
    assert "the run is partial: it was interrupted at t = " in capsys.readouterr().err
    assert [name for name, _ in opened] == ["run.rrd"]


@pytest.mark.slow
@posix
def test_a_killed_run_can_be_replayed_up_to_the_last_block(opened, capsys):
    process = started()
    process.kill()
    process.communicate(timeout=1800)
    assert runs.read_description(Path("a"))["status"] == "running"
    assert cli.main(["replay", "a"]) == 0
    assert "the run is partial: it is still going on or was killed" in capsys.readouterr().err
    ((name, entities),) = opened
    assert name == "run.rrd"
    assert {"/world/tube", "/signals"} <= entities
    assert cli.main(["record", "a", "--out", "again.rrd"]) == 0  # from the blocks of its arrays
    assert "the run is partial" in capsys.readouterr().err
    run, _ = runs.map_run(Path("a"))
    assert len(run) % 5000 == 0
    np.testing.assert_array_equal(fields("again.rrd", "/signals")["tau"], run.tau)
    assert cli.main(["run", "--duration", "0.02", "--out", "a"]) == 2
    assert cli.main(["run", "--duration", "0.02", "--out", "a", "--force"]) == 0
    assert {p.name for p in Path("a").iterdir()} == {"run.npz", "run.json", "run.rrd"}


def test_a_recording_can_be_named_itself(opened):
    run = folder("a")
    cli.main(["record", str(run)])
    assert cli.main(["replay", "a/run.rrd"]) == 0
    assert opened[0][0] == "run.rrd"
    assert replay_commands._SWEEP == "manifest.json"

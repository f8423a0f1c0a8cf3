"""What the `.rrd` file of a run holds, and that failures leave none."""

import dataclasses
import subprocess
import sys

import numpy as np
import pytest
import rerun as rr

from octarm.lagrange import positions
from octarm.model import world_position
from octarm.parameters import ArmParameters
from octarm.recording import write_recording
from octarm.scene import plate_quaternions, smooth_arm
from octarm.trajectory import Trajectory


def arm(modules):
    ones = np.ones(modules)
    return ArmParameters(
        mass=0.2 * ones,
        inertia=5e-4 * ones,
        width=0.08,
        stiffness=1000.0 * np.ones((2, modules)),
        damping=10.0 * np.ones((2, modules)),
        rest_length=0.12 * ones,
        gravity=9.81,
    )


def swinging(modules=3, rows=2500, rate=2000.0, **signals):
    """A run made of sines, with noise in every digit so that rounding cannot hide."""
    t = np.arange(rows) / rate
    phase = t[:, None] + np.arange(modules)
    q_d = np.concatenate([0.12 + 0.01 * np.sin(7 * phase), 0.3 * np.sin(3 * phase)], axis=1)
    noise = np.random.default_rng(0).normal(size=(rows, 2 * modules))
    return Trajectory(
        t=t,
        q=q_d + 1e-3 * noise,
        q_d=q_d,
        disturbance=0.0 * noise,
        signals={"s": 2.0 * noise, **{k: np.asarray(v) for k, v in signals.items()}},
        digest="0123abcd",
        v=noise[::-1],
        v_d=noise,
        tau=np.roll(noise, 1, axis=0),
        force=noise,
    )


def record(tmp_path, run, **options):
    path = tmp_path / "run.rrd"
    write_recording(path, run, arm(run.q.shape[1] // 2), title="a run", **options)
    return path


def chunks(path, entity):
    """The temporal record batches of an entity, in the order of the rows."""
    found = [c for c in rr.chunk.RrdReader(path).stream() if c.entity_path == entity]
    batches = [c.to_record_batch() for c in found if not c.is_static]
    return sorted(batches, key=lambda batch: batch.column("step")[0].as_py())


def column(path, entity, name):
    parts = [batch.column(name) for batch in chunks(path, entity)]
    return np.concatenate([flat(part) for part in parts])


def flat(array):
    while hasattr(array, "flatten") and hasattr(array.type, "value_type"):
        array = array.flatten()
    return array.to_numpy(zero_copy_only=False)


def scalars(path, entity, rows):
    return column(path, entity, "Scalars:scalars").reshape(rows, -1)


@pytest.mark.parametrize("modules", [1, 3, 5])
def test_every_signal_comes_back_bit_for_bit(tmp_path, modules):
    run = swinging(modules, gain=np.random.default_rng(1).normal(size=(2500, 30)))
    path = record(tmp_path, run)
    for entity, values in (
        ("/q", run.q),
        ("/desired", run.q_d),
        ("/error", run.error),
        ("/signals/s", run.signals["s"]),
    ):
        back = [scalars(path, f"{entity}/{kind}", len(run)) for kind in ("slides", "angles")]
        np.testing.assert_array_equal(np.concatenate(back, axis=1), values)
    np.testing.assert_array_equal(scalars(path, "/tau", len(run)), run.tau)
    np.testing.assert_array_equal(scalars(path, "/signals/gain", len(run)), run.signals["gain"])


def test_the_timelines_are_the_rows_and_the_rounded_time(tmp_path):
    run = swinging()
    path = record(tmp_path, run)
    steps = column(path, "/tau", "step")
    np.testing.assert_array_equal(steps, np.arange(len(run)))
    t = column(path, "/tau", "t").astype("timedelta64[ns]").astype(np.int64)
    np.testing.assert_array_equal(t, 500_000 * np.arange(len(run)))
    assert max(batch.num_rows for batch in chunks(path, "/tau")) <= 1000


@pytest.mark.parametrize("rate", [50.0, 500.0, 2000.0])
def test_the_scene_has_about_60_frames_a_second(tmp_path, rate):
    path = record(tmp_path, swinging(rows=1500, rate=rate))
    spacing = np.diff(column(path, "/world/backbone", "step")) / rate
    assert np.ptp(spacing) == 0.0
    assert 1 / spacing[0] == pytest.approx(min(rate, 60.0), rel=0.08)


@pytest.mark.parametrize("modules", [1, 5])
def test_the_drawn_arm_is_smooth_and_ends_where_the_lumped_arm_ends(tmp_path, modules):
    run = swinging(modules)
    path = record(tmp_path, run)
    rows = column(path, "/world/backbone", "step")
    strips = column(path, "/world/backbone", "LineStrips3D:strips").reshape(
        len(rows), modules, -1, 3
    )
    ends = world_position(positions(run.q[rows]))
    np.testing.assert_allclose(strips[:, :, -1], ends, atol=1e-6)
    np.testing.assert_allclose(strips[:, 1:, 0], ends[:, :-1], atol=1e-6)
    steps = np.diff(strips, axis=2)
    steps /= np.linalg.norm(steps, axis=-1, keepdims=True)
    turns = np.sum(steps[:, :-1, -1] * steps[:, 1:, 0], axis=-1)
    assert np.all(turns > np.cos(0.1))  # chords of 12 points: no kink between modules


def test_the_columns_differ_in_length_as_the_model_says(tmp_path):
    run = swinging()
    path = record(tmp_path, run)
    rows = column(path, "/world/columns", "step")
    strips = column(path, "/world/columns", "LineStrips3D:strips").reshape(len(rows), 2, 3, -1, 3)
    lengths = np.linalg.norm(np.diff(strips, axis=3), axis=-1).sum(axis=-1)
    expected = 0.08 * run.q[rows, 3:]
    np.testing.assert_allclose(lengths[:, 0] - lengths[:, 1], expected, atol=2e-4)


def test_the_file_is_valid_and_carries_layout_and_metadata(tmp_path):
    properties = {"seed": 3, "controller": "smc", "gains": {"K": [1.0, 2.0]}}
    path = record(tmp_path, swinging(), notes="# Notes", properties=properties)
    verify = [sys.executable, "-m", "rerun_cli", "rrd", "verify", str(path)]
    assert subprocess.run(verify, capture_output=True).returncode == 0
    reader = rr.chunk.RrdReader(path)
    assert len(reader.blueprints()) == 1
    (store,) = reader.recordings()
    assert (store.application_id, store.recording_id) == ("octarm", "0123abcd")
    static = {c.entity_path: c.to_record_batch() for c in reader.stream() if c.is_static}
    assert static["/notes"].column("TextDocument:text").to_pylist() == [["# Notes"]]
    assert static["/__properties"].column("RecordingInfo:name").to_pylist() == [["a run"]]
    run = static["/__properties/run"].to_pydict()
    assert (run["seed"], run["controller"]) == ([[3]], [["smc"]])
    assert run["gains"] == [['{"K": [1.0, 2.0]}']]


def test_the_plots_name_the_coordinates_but_not_a_wide_signal(tmp_path):
    path = record(tmp_path, swinging(gain=np.ones((2500, 30))))
    static = {c.entity_path: c for c in rr.chunk.RrdReader(path).stream() if c.is_static}
    angles = static["/q/angles"].to_record_batch()
    assert angles.column("SeriesLines:names").to_pylist() == [["theta1", "theta2", "theta3"]]
    gain = static["/signals/gain"].to_record_batch()
    assert "SeriesLines:names" not in gain.schema.names


def test_a_signal_may_have_any_name_and_shape(tmp_path):
    odd = {"error": np.ones(2500), "a name/with: +": np.ones((2500, 2)), "none": np.ones((2500, 0))}
    path = record(tmp_path, swinging(**odd))
    names = {c.entity_path for c in rr.chunk.RrdReader(path).stream()}
    assert any("name" in name for name in names)
    assert scalars(path, "/signals/error", 2500).shape == (2500, 1)


def test_a_diverged_run_is_recorded_with_the_frames_that_can_be_drawn(tmp_path):
    run = swinging()
    q = run.q.copy()
    q[1200:] *= 1e30
    q[-1] = np.nan
    broken = dataclasses.replace(run, q=q, status="diverged")
    path = record(tmp_path, broken)
    assert column(path, "/world/backbone", "step").max() < 1200
    np.testing.assert_array_equal(scalars(path, "/q/angles", 2500), q[:, 3:])


@pytest.mark.parametrize("rows", [1, 2])
def test_the_shortest_runs_are_recorded(tmp_path, rows):
    path = record(tmp_path, swinging(rows=rows))
    assert len(column(path, "/tau", "step")) == rows


def test_what_is_not_one_arm_is_refused(tmp_path):
    run = swinging()
    with pytest.raises(ValueError, match="modules"):
        write_recording(tmp_path / "run.rrd", run, arm(2), title="")
    with pytest.raises(ValueError, match="no rows"):
        write_recording(tmp_path / "run.rrd", swinging(rows=0), arm(3), title="")
    assert list(tmp_path.iterdir()) == []


def test_an_unwritable_place_is_one_sentence_and_leaves_nothing(tmp_path):
    (tmp_path / "file").touch()
    path = tmp_path / "file" / "run.rrd"
    with pytest.raises(OSError, match=r"run\.rrd cannot be written: Not a directory$"):
        write_recording(path, swinging(), arm(3), title="")
    with pytest.raises(OSError, match="No such file or directory"):
        write_recording(tmp_path / "folder" / "run.rrd", swinging(), arm(3), title="")


@pytest.mark.skipif(sys.platform != "linux", reason="/dev/full is a Linux device")
def test_a_full_disk_leaves_the_file_that_was_there(tmp_path):
    path = tmp_path / "run.rrd"
    path.write_text("before")
    (tmp_path / "run.rrd.part").symlink_to("/dev/full")
    with pytest.raises(OSError, match=r"cannot be written: No space left on device$"):
        write_recording(path, swinging(), arm(3), title="")
    assert [p.name for p in tmp_path.iterdir()] == ["run.rrd"]
    assert path.read_text() == "before"


def test_a_failure_halfway_leaves_nothing(tmp_path, monkeypatch):
    def fail(self, **_):
        raise RuntimeError("File-writer thread shut down prematurely\nmore")

    monkeypatch.setattr(rr.RecordingStream, "flush", fail)
    with pytest.raises(RuntimeError, match=r"cannot be recorded: .* prematurely$"):
        record(tmp_path, swinging())
    assert list(tmp_path.iterdir()) == []
    assert not rr.strict_mode()


def test_a_rerun_that_is_switched_off_is_an_error(tmp_path, monkeypatch):
    monkeypatch.setenv("RERUN", "off")
    with pytest.raises(RuntimeError, match="cannot be recorded"):
        record(tmp_path, swinging())
    assert list(tmp_path.iterdir()) == []


def test_plates_face_along_the_arm():
    q = np.array([0.1, 0.1, 0.1, 0.3, -0.5, 0.2])
    curve = smooth_arm(q)
    x, y, z, w = np.moveaxis(plate_quaternions(q), -1, 0)
    # The plate's axis, world z, turned by its quaternion, is the tangent of the curve at its end.
    axis = np.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)], axis=-1)
    steps = np.diff(curve, axis=1)
    tangent = 1.5 * steps[:, -1] - 0.5 * steps[:, -2]
    tangent /= np.linalg.norm(tangent, axis=-1, keepdims=True)
    np.testing.assert_allclose(axis, -tangent, atol=0.02)

"""What the `.rrd` file of a run holds, and that failures leave none."""

import dataclasses
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
import rerun as rr
from recordings import (
    chunks,
    column,
    described,
    entities,
    fields,
    part_of,
    static,
    swinging,
)

from octarm.arm.lagrange import positions
from octarm.arm.mjcf import world_position
from octarm.errors import OctarmError
from octarm.recordings.blueprints import Plots, reach, span
from octarm.recordings.channels import channels_of
from octarm.recordings.recording import run_recording, write_recording
from octarm.recordings.rrd import last_instant, telling_instant


def record(tmp_path, run, **more):
    path = tmp_path / "run.rrd"
    write_recording(path, run, described(run.q.shape[1] // 2, **more))
    return path


def verified(path):
    verify = [sys.executable, "-m", "rerun_cli", "rrd", "verify", str(path)]
    return subprocess.run(verify, capture_output=True).returncode == 0


@pytest.mark.parametrize("modules", [1, 3, 5])
def test_every_signal_comes_back_in_units_that_people_read(tmp_path, modules):
    """Lengths in mm, angles in mrad, forces in N and mN m, energies in mJ: to the last digit."""
    run = swinging(modules, rows=7000, gain=np.random.default_rng(1).normal(size=(7000, 30)))
    found = fields(record(tmp_path, run), "/signals")
    thousandth, moments = np.full(2 * modules, 1e3), np.repeat([1.0, 1e3], modules)
    for name, values, factor, kind in (
        ("q", run.q, thousandth, np.float64), ("q_d", run.q_d, thousandth, np.float64),
        ("s", run.signals["s"], thousandth, np.float32),
        ("error", run.error, thousandth, np.float32),
        ("switching", run.signals["switching"], moments, np.float32),
    ):  # fmt: skip
        both = np.concatenate([found[f"{name}_slides"], found[f"{name}_bends"]], axis=1)
        np.testing.assert_array_equal(both, (factor * values).astype(kind))
        assert both.dtype == kind
    np.testing.assert_array_equal(found["V"], 1e3 * run.signals["V"])
    np.testing.assert_array_equal(found["gain"], run.signals["gain"])
    np.testing.assert_array_equal(found["tau"], run.tau)
    channels = channels_of(dict(run.arrays()), described(modules), run.layer, disturbed=True)
    units = {part: channels["switching"].recorded(part)[1] for part in ("slides", "bends")}
    assert units == {"slides": " [N]", "bends": " [mN m]"}
    titles = [plot.name for plot in Plots(channels, 1.0).tracking("bends")]
    assert titles == ["bends [mrad]   wide: desired", "error of bends [mrad]   grey: phi / lambda"]
    assert Plots(channels, 1.0).views("q")[0].name == "coordinates q, bends [mrad]"


def test_the_rate_of_V_and_its_claim_are_those_of_the_signals(tmp_path):
    run = swinging(rows=7000)
    found = fields(record(tmp_path, run), "/signals")
    V = run.signals["V"][:, 0]
    np.testing.assert_allclose(found["V_rate"][1:, 0], 1e3 * np.diff(V) / np.diff(run.t), rtol=1e-5)
    claim = 1e3 * np.sum(run.signals["s"] * run.signals["switching"], axis=1)
    np.testing.assert_allclose(found["V_claim"][:, 0], claim, rtol=1e-6)


def test_what_adapts_is_recorded_60_times_a_second_and_numbers_of_rules_are_drawn(tmp_path):
    draw = np.random.default_rng(1)
    run = swinging(theta=draw.normal(size=(2500, 6, 5)), E=draw.normal(size=(2500, 6)))
    path = record(tmp_path, run)
    found = fields(path, "/adaptation")
    E = np.concatenate([found["E_slides"], found["E_bends"]], axis=1)
    newton = np.repeat([1.0, 1e3], 3)  # mN m for bends
    np.testing.assert_array_equal(E, (newton * run.signals["E"][::17]).astype(np.float32))
    assert {"/heat/theta/picture", "/heat/now"} <= entities(path)
    assert not {"theta", "E_bends"} & fields(path, "/signals").keys()


def test_ten_seconds_at_1_kHz_have_less_than_4_MB_even_of_noise(tmp_path):
    """Every bit of every number is new, but of the slides that are to stay."""
    run = swinging(rows=10_000)
    rules = np.sin(run.t)[:, None, None] * np.linspace(0.1, 1.0, 5) * np.ones((6, 5))
    signals = {**run.signals, **dict.fromkeys(("theta", "alpha", "sigma"), rules)}
    signals |= dict.fromkeys(("equivalent", "f_hat", "E"), run.v) | {"s": 1e-3 * run.v}
    q_d = np.concatenate([np.full((10_000, 3), 0.12), run.q_d[:, 3:]], axis=1)
    adaptive = dataclasses.replace(run, q_d=q_d, signals=signals)
    assert record(tmp_path, adaptive).stat().st_size < 4e6


def test_the_time_is_rounded_to_nanoseconds(tmp_path):
    path = record(tmp_path, swinging(rate=2000.0))
    t = column(path, "/signals", "t").astype("timedelta64[ns]").astype(np.int64)
    np.testing.assert_array_equal(t, 500_000 * np.arange(2500))
    assert last_instant(path) == pytest.approx(1.2495)


@pytest.mark.parametrize("rate", [50.0, 500.0, 2000.0])
def test_the_scene_has_about_60_frames_a_second(tmp_path, rate):
    path = record(tmp_path, swinging(rows=1500, rate=rate))
    t = column(path, "/world/tube", "t").astype("timedelta64[ns]").astype(np.int64)
    spacing = np.diff(t)
    assert np.ptp(spacing) == 0
    assert 1e9 / spacing[0] == pytest.approx(min(rate, 60.0), rel=0.08)


def test_the_trail_is_the_way_of_the_tip(tmp_path):
    run = swinging(rows=7000)
    path = record(tmp_path, run)
    for entity, q in (("/world/trail", run.q), ("/world/desired_path", run.q_d)):
        ends = world_position(positions(q[::17])[:, -1])
        pieces = column(path, entity, "LineStrips3D:strips").reshape(-1, 2, 3)
        np.testing.assert_allclose(pieces[:, 1], ends, atol=7e-5)  # half of the grid
        np.testing.assert_allclose(pieces[1:, 0], ends[:-1], atol=7e-5)


def test_columns_show_push_and_pull(tmp_path):
    run = swinging(rows=200)
    tau = np.tile([20.0, -20.0, 0.0, 0.0, 0.0, 0.0], (200, 1))
    path = record(tmp_path, dataclasses.replace(run, tau=tau))
    colors = column(path, "/world/columns", "Cylinders3D:colors").reshape(-1, 6, 4)[:, :, 0]
    radii = column(path, "/world/columns", "Cylinders3D:radii").reshape(-1, 6, 4)[:, :, 0]
    red, green = (colors >> 24) & 0xFF, (colors >> 16) & 0xFF
    assert np.all(red[:, 0] > 2 * green[:, 0])  # pushes
    assert np.all(green[:, 1] > 200)  # pulls
    assert np.all(radii[:, :2] > 1.5 * radii[:, 2:].max())


def test_a_disturbance_has_arrows_and_a_payload_its_ball(tmp_path):
    run = swinging(rows=2500)
    run = dataclasses.replace(run, disturbance=run.force)
    asked = [{"name": "payload", "asked": {"mass": 0.2, "at": 1.0}}]
    path = record(tmp_path, run, disturbances=asked)
    assert {"/world/disturbance", "/ledger", "/states/payload"} <= entities(path)
    balls = column(path, "/world/payload", "InstancePoses3D:translations").reshape(-1, 3)
    sizes = column(path, "/world/payload", "Ellipsoids3D:half_sizes").reshape(-1, 3)
    assert np.all(sizes[:58] == 0.0)  # until it is there
    np.testing.assert_allclose(sizes[59:], 0.0183, atol=1e-4)
    ends = world_position(positions(run.q[::17])[:, -1])
    np.testing.assert_allclose(np.linalg.norm(balls[60:] - ends[60:], axis=1), 0.0211, atol=2e-3)
    assert "/world/disturbance" not in entities(record(tmp_path, swinging()))


def test_the_file_is_valid_and_carries_layout_and_metadata(tmp_path):
    path = record(tmp_path, swinging())
    assert verified(path)
    reader = rr.chunk.RrdReader(path)
    assert len(reader.blueprints()) == 1
    (store,) = reader.recordings()
    assert store.application_id == "octarm"
    fixed = static(path)
    assert "octarm run" in fixed["/notes"].column("TextDocument:text").to_pylist()[0][0]
    assert fixed["/__properties"].column("RecordingInfo:name").to_pylist() == [["smc on sine"]]
    run = fixed["/__properties/run"].to_pydict()
    assert (run["seed"], run["status"]) == ([[3]], [["ok"]])
    assert '"lambda_": 10.0' in run["controller"][0][0]


def test_bounds_are_lines_from_end_to_end(tmp_path):
    found = fields(record(tmp_path, swinging()), "/bounds/error", "bounds")
    np.testing.assert_allclose(found["bends"], [[80.0, -80.0]] * 2)  # [mrad]
    np.testing.assert_allclose(found["slides"], [[5.0, -5.0]] * 2)  # [mm]


def test_a_signal_may_have_any_name_and_shape(tmp_path):
    odd = {"error": np.ones(2500), "a name/with: +": np.ones((2500, 2)), "none": np.ones((2500, 0))}
    found = fields(record(tmp_path, swinging(**odd)), "/signals")
    assert found["error_"].shape == (2500, 1)
    assert found["a_name_with___"].shape == (2500, 2)


def test_a_diverged_run_is_recorded_with_the_frames_that_can_be_drawn(tmp_path):
    run = swinging()
    q = run.q.copy()
    q[1200:] *= 1e30
    q[-1] = np.nan
    broken = dataclasses.replace(run, q=q, status="diverged")
    path = record(tmp_path, broken, status="diverged", duration=10.0)
    t = column(path, "/world/tube", "t").astype("timedelta64[ns]").astype(np.int64)
    assert t.max() < 1.2e9
    np.testing.assert_array_equal(fields(path, "/signals")["q_bends"], 1e3 * q[:, 3:])
    states = [
        batch.column("StateChange:state").to_pylist() for batch in chunks(path, "/states/run")
    ]
    assert states == [[["running"], ["diverged"]]]


def test_events_are_lines_across_every_plot(tmp_path):
    """Each from the lowest to the highest number of its plot, the desired motion included."""
    run = dataclasses.replace(swinging(), status="diverged")
    payload = {"name": "payload", "asked": {"mass": 0.1, "at": 0.7}}
    noise = {"name": "noise", "asked": {"ratio": 0.4}}  # acts from the beginning: no event
    path = record(tmp_path, run, disturbances=[noise, payload], status="diverged")
    for kind, at in (("begins", 0.7), ("ends", run.t[-1])):
        t = column(path, f"/events/{kind}", "t").astype("timedelta64[ns]").astype(np.int64)
        np.testing.assert_allclose(1e-9 * t, [at] * 3)
        found = fields(path, f"/events/{kind}", "events")
        both = 1e3 * np.concatenate([run.q, run.q_d])[:, 3:]
        for plot in ("q_bends", "q_d_bends"):
            np.testing.assert_allclose(found[plot].ravel(), [both.min(), both.max(), np.nan])
        ends = [run.tau.min(), run.tau.max(), np.nan]
        np.testing.assert_allclose(found["tau"].ravel(), ends)
        signals = fields(path, "/signals").keys()
        assert {x.replace("q_d_", "q_") for x in signals} <= {*found}
    channels = channels_of(dict(run.arrays()), described(), run.layer, disturbed=True)
    plots = Plots(channels, 1.0, "", {"begins": "payload 100 g", "ends": "diverged"})
    for view in (*plots.tracking("bends"), *plots.views("tau"), plots.energy_rate()):
        assert {"events/begins", "events/ends"} <= {*view.contents}
    assert not any("events" in x for x in Plots(channels, 1.0).views("tau")[0].contents)


@pytest.mark.parametrize("rows", [1, 2])
def test_the_shortest_runs_are_recorded(tmp_path, rows):
    path = record(tmp_path, swinging(rows=rows))
    assert len(fields(path, "/signals")["tau"]) == rows


def test_it_is_the_same_whatever_the_blocks(tmp_path):
    run = swinging(theta=np.random.default_rng(1).normal(size=(2500, 6, 5)))
    once = fields(record(tmp_path, run), "/signals")
    path = tmp_path / "blocks.rrd"
    memory = {name: np.empty_like(array[:300]) for name, array in run.arrays()}
    with run_recording(path, described()) as recording:
        for k in range(0, 2500, 300):
            for name, array in part_of(run, k, k + 300).arrays():
                memory[name][: len(array)] = array
            rows = {name: array[: len(run.t[k : k + 300])] for name, array in memory.items()}
            recording.add(rows, run.layer)
            for array in memory.values():  # whoever keeps rows has copied them
                array[:] = np.nan
        recording.finish(described())
    assert verified(path)
    blocks = fields(path, "/signals")
    for name, values in once.items():
        np.testing.assert_array_equal(blocks[name][1:], values[1:])  # V has no rate at first
    for name in ("/world/tube", "/world/trail", "/world/columns"):
        for component in chunks(path, name)[0].schema.names:
            if ":" in component and "rotation" not in component:
                whole = column(tmp_path / "run.rrd", name, component)
                np.testing.assert_array_equal(column(path, name, component), whole)


@pytest.mark.skipif(os.name != "posix", reason="signals as on POSIX")
@pytest.mark.filterwarnings("ignore")  # what was killed writes no footer
def test_what_was_added_survives_a_kill(tmp_path):
    script = (
        "import os, signal, sys; from pathlib import Path; sys.path.insert(0, sys.argv[2])\n"
        "from recordings import described, part_of, swinging\n"
        "from octarm.recordings.recording import run_recording\n"
        "run = swinging()\n"
        "with run_recording(Path(sys.argv[1]), described(duration=60.0)) as recording:\n"
        "    recording.add(dict(part_of(run, 0, 1000).arrays()))\n"
        "    recording.add(dict(part_of(run, 1000, 2000).arrays()))\n"
        "    __import__('time').sleep(0.3)\n"
        "    os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    path = tmp_path / "run.rrd"
    command = [sys.executable, "-c", script, str(path), os.path.dirname(__file__)]
    assert subprocess.run(command, check=False).returncode == -signal.SIGKILL
    assert [p.name for p in tmp_path.iterdir()] == ["run.rrd.part"]
    found = fields(tmp_path / "run.rrd.part", "/signals")
    np.testing.assert_array_equal(found["tau"], swinging().tau[:2000])


def test_the_telling_instant_is_that_of_the_largest_bend_or_the_end(tmp_path):
    run = swinging(rows=3000)
    size = np.abs(run.q[:, 3:]).sum(axis=1)
    path = record(tmp_path, run)
    assert telling_instant(path) == pytest.approx(run.t[np.argmax(size)], abs=1e-9)
    path = record(tmp_path, run, status="diverged")
    assert telling_instant(path) == pytest.approx(run.t[-1])


def test_plots_that_would_be_empty_and_bounds_that_are_far_off_are_not_drawn(tmp_path):
    run = swinging(rows=50)
    channels = channels_of(dict(run.arrays()), described(), run.layer, disturbed=True)
    lists = [channel.column(part) for channel in channels.values() for part in channel.parts]
    extremes = dict.fromkeys(lists, (-1e3, 1e3)) | {"error_bends": (-1.0, 1.0)}
    extremes |= dict.fromkeys(("disturbance_slides", "disturbance_bends"), (0.0, 0.0))
    plots = Plots(channels, 1.0, extremes=extremes)
    assert plots.views("disturbance") == []
    assert len(plots.views("s")) == 2
    assert "phi / lambda = 80, far off" in plots.bounded("error", "error", "bends").name
    assert "grey: phi" in plots.bounded("s", "s", "bends").name
    unknown = Plots(channels, 1.0)
    assert len(unknown.views("disturbance")) == 2


def test_what_is_not_one_arm_is_refused(tmp_path):
    with pytest.raises(ValueError, match="modules"):
        write_recording(tmp_path / "run.rrd", swinging(), described(2))
    with pytest.raises(ValueError, match="no rows"):
        write_recording(tmp_path / "run.rrd", swinging(rows=0), described())
    assert list(tmp_path.iterdir()) == []


def test_an_unwritable_place_is_one_sentence_and_leaves_nothing(tmp_path):
    (tmp_path / "file").touch()
    path = tmp_path / "file" / "run.rrd"
    with pytest.raises(OSError, match=r"run\.rrd cannot be written: Not a directory$"):
        write_recording(path, swinging(), described())
    with pytest.raises(OSError, match="No such file or directory"):
        write_recording(tmp_path / "folder" / "run.rrd", swinging(), described())


@pytest.mark.skipif(sys.platform != "linux", reason="/dev/full is a Linux device")
def test_a_full_disk_leaves_the_file_that_was_there(tmp_path):
    path = tmp_path / "run.rrd"
    path.write_text("before")
    (tmp_path / "run.rrd.part").symlink_to("/dev/full")
    with pytest.raises(OSError, match=r"cannot be written: No space left on device$"):
        write_recording(path, swinging(), described())
    assert [p.name for p in tmp_path.iterdir()] == ["run.rrd"]
    assert path.read_text() == "before"


def test_a_failure_halfway_leaves_nothing(tmp_path, monkeypatch):
    def fail(self, **_):
        raise RuntimeError("File-writer thread shut down prematurely\nmore")

    monkeypatch.setattr(rr.RecordingStream, "flush", fail)
    with pytest.raises(OctarmError, match=r"cannot be recorded: .* prematurely$"):
        record(tmp_path, swinging())
    assert list(tmp_path.iterdir()) == []
    assert not rr.strict_mode()


def test_a_rerun_that_is_switched_off_is_an_error(tmp_path, monkeypatch):
    monkeypatch.setenv("RERUN", "off")
    with pytest.raises(OctarmError, match="cannot be recorded"):
        record(tmp_path, swinging())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("size", [1e-4, 0.97, 1.0, 4.4, 4.7, 9.3, 55.0, 123.0])
def test_an_axis_about_zero_has_three_labels(size: float):
    """The viewer labels multiples of the power of ten of which at most nine are in sight."""
    ends = reach(size)
    assert ends is not None and -ends[0] == ends[1]
    end = ends[1]
    assert size < end < 2.6 * size
    step = 10.0 ** np.ceil(np.log10(2.0 * end / 8.9))
    assert 2 * np.floor(end / step) + 1 >= 3
    assert reach(0.0) is None and reach(np.inf) is None


@pytest.mark.parametrize(
    ("low", "high"),
    [(121.2, 123.4), (121.4, 121.9), (-0.3, 0.1), (0.0, 9.0), (122.0, 122.95), (-0.02, 0.0)],
)
def test_an_axis_anywhere_has_three_labels(low: float, high: float):
    bottom, top = span(low, high) or (low, high)
    assert bottom <= low and high <= top and top - bottom < 4.5 * max(high - low, 1e-9)
    step = 10.0 ** np.ceil(np.log10((top - bottom) / 8.9))
    assert np.floor(top / step) - np.ceil(bottom / step) >= 2
    assert span(1.0, 1.0) is None and span(-350.0, 350.0) is None and span(0.0, np.inf) is None

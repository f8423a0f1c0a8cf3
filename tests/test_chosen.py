"""Which episodes of a sweep are recorded, and that they are recorded as they were."""

import functools
import json
import shutil
from pathlib import Path

import pyarrow as pa
import pytest
from test_verify import Inline

import octarm
from controllers import make_controller
from octarm.checks.verify import check_run
from octarm.commands.cli import main
from octarm.runs import folder as runs
from octarm.sweeps import episodes
from octarm.sweeps.episodes import METRIC, FinishedSweep, record_episodes, select
from octarm.sweeps.shards import begin
from octarm.sweeps.spec_file import parse_spec
from octarm.sweeps.store import RECORDED

SPEC = """\
seed = 4
gain_set = "recommended"
episodes = 2
duration = 0.2
settle = 0.1
timestep = 0.001
control_period = 0.002
batch = 4
[grid]
controller = ["pd", "smc-boundary"]
[grid.disturbance]
noise = [0.2, 0.4]
[disturbance]
noise-2.ratio = 0.1
noise-2.time = 0.05
[record]
episodes = ["worst", "median", 6]
"""


def table(*rows: tuple[str, float | None, float | None], first: int = 0) -> pa.Table:
    """Rows of controller, tip error and instant of divergence."""
    return pa.table(
        {
            "episode": list(range(first, first + len(rows))),
            "controller": [row[0] for row in rows],
            "status": ["ok" if row[2] is None else "diverged" for row in rows],
            "diverged_at": pa.array([row[2] for row in rows], pa.float64()),
            METRIC: pa.array([row[1] for row in rows], pa.float64()),
        }
    )


TABLE = table(
    ("a", 3.0, None),
    ("a", 1.0, None),
    ("a", None, 0.7),
    ("a", 2.0, None),
    ("a", None, 0.2),
    ("a", 9.0, None),
    ("b", 5.0, None),
    ("b", 7.0, None),
    first=10,
)


def test_the_words_mean_one_episode_of_each_controller():
    assert select(TABLE, ["worst"]).reasons == {15: ("worst",), 17: ("worst",)}
    # Of 1, 2, 3, 9 and of 5, 7 the lower middle one.
    assert select(TABLE, ["median"]).reasons == {13: ("median",), 16: ("median",)}
    assert select(TABLE, ["diverged"]).reasons == {14: ("diverged",)}
    assert select(TABLE, ["diverged"]).notes == ()
    assert select(TABLE, []).reasons == {}


def test_the_order_of_the_rows_does_not_matter():
    upside_down = TABLE.take(list(range(len(TABLE)))[::-1])
    for word in ("worst", "median", "diverged"):
        assert select(upside_down, [word]).reasons == select(TABLE, [word]).reasons


def test_of_equals_it_is_the_first():
    equal = table(("a", 2.0, None), ("a", 1.0, None), ("a", 2.0, None), ("a", 2.0, None))
    assert select(equal, ["worst"]).reasons == {0: ("worst",)}
    assert select(equal, ["median"]).reasons == {0: ("median",)}
    lost = table(("a", None, 0.5), ("a", None, 0.5))
    assert select(lost, ["diverged"]).reasons == {0: ("diverged",)}


def test_one_episode_may_have_several_reasons():
    single = table(("a", 1.0, None), ("b", 2.0, None))
    found = select(single, ["worst", 1, "median", "worst"])
    assert found.reasons == {0: ("worst", "median"), 1: ("worst", "chosen", "median")}


def test_what_is_not_there_is_said():
    nothing = table(("a", None, None), ("a", None, 0.1), ("b", 1.0, None))
    found = select(nothing, ["median", "worst"])
    assert found.reasons == {2: ("median", "worst")}
    assert [note.partition(":")[0] for note in found.notes] == [
        "no episode of a is the median one",
        "no episode of a is the worst one",
    ]
    with pytest.raises(ValueError, match="there is no episode 18 in the table"):
        select(TABLE, [18])


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("sweep") / "sweep"
    octarm.sweep(parse_spec(SPEC), make_controller, folder, executor=Inline(), in_flight=1)
    return folder


@pytest.fixture
def sweep(finished, tmp_path) -> Path:
    return shutil.copytree(finished, tmp_path / "sweep")


def record(folder: Path, reasons, **options):
    return record_episodes(FinishedSweep(folder), reasons, make_controller, **options)


def recorded(folder: Path) -> set[str]:
    return {path.name for path in (folder / RECORDED).iterdir()}


def test_an_episode_is_a_run_of_one_arm(sweep):
    plan = FinishedSweep(sweep).plan
    what = FinishedSweep(sweep).experiment(5)
    environment, controller = what.begin(functools.partial(make_controller, gain_set="recommended"))
    other, same = begin(plan.spec, plan.episode(5), make_controller)
    assert environment.physics.timestep() == other.physics.timestep() == 0.001
    assert environment.control_timestep() == other.control_timestep() == 0.002
    first, second = (octarm.rollout(e, controller, 0.05) for e in (environment, other))
    other.task.next_episode = 0
    assert first.digest == second.digest == octarm.rollout(other, same, 0.05).digest
    assert what.spawn_key == (1,)


def test_what_is_recorded_is_what_the_table_says_and_is_left_alone_afterwards(sweep):
    begun = []
    count = []
    reasons = {1: ("worst",), 6: ("chosen",)}
    different = record(
        sweep,
        reasons,
        begin=lambda n, text: begun.append((n, text)),
        progress=lambda: count.append(0),
    )
    assert different == {}
    assert recorded(sweep) == {"1-worst", "6-chosen"}
    assert begun == [
        (100, "recording episode 1 (worst)"),
        (100, "recording episode 6 (chosen)"),
    ]
    assert len(count) == 200
    for name in recorded(sweep):
        folder = sweep / RECORDED / name
        assert {p.name for p in folder.iterdir()} == {"run.rrd", "run.npz", "run.json"}
        assert check_run(folder, make_controller).identical
        row = FinishedSweep(sweep).row(int(name.partition("-")[0])).to_pylist()[0]
        metrics = runs.read_description(folder)["metrics"]
        assert metrics["tip_rms_error"] == row["tip_rms_error"]
        assert metrics["rms_error"] == [
            row[f"rms_error_{c}{i}"] for c in ("s", "theta") for i in (1, 2, 3)
        ]
    assert record(sweep, reasons, begin=lambda *_: pytest.fail("it is there")) == {}
    record(sweep, {1: ("median", "worst")}, begin=lambda *_: pytest.fail("it is there"))
    assert recorded(sweep) == {"1-median-worst", "6-chosen"}


def test_an_interrupt_leaves_whole_folders_and_the_next_call_goes_on(sweep):
    steps = []

    def progress() -> None:
        steps.append(0)
        if len(steps) == 130:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        record(sweep, {0: ("worst",), 7: ("worst",)}, progress=progress)
    assert recorded(sweep) == {"0-worst"}
    begun = []
    record(sweep, {0: ("worst",), 7: ("worst",)}, begin=lambda _, text: begun.append(text))
    assert begun == ["recording episode 7 (worst)"]
    assert recorded(sweep) == {"0-worst", "7-worst"}


def test_what_a_killed_process_left_is_recorded_again(sweep):
    left = sweep / RECORDED / "3-worst"
    left.mkdir(parents=True)
    (left / "run.json.part").write_text("{")
    (left / "run.rrd.part").write_bytes(b"half")
    record(sweep, {3: ("worst",)})
    assert {p.name for p in left.iterdir()} == {"run.rrd", "run.npz", "run.json"}
    description = json.loads((left / "run.json").read_text())
    (left / "run.json").write_text(json.dumps(description | {"status": "running"}))
    begun = []
    record(sweep, {3: ("worst",)}, begin=lambda *_: begun.append(0))
    assert begun == [0]
    assert runs.read_description(left)["status"] == "ok"


def test_a_row_that_is_not_what_was_recorded_is_reported(sweep, monkeypatch):
    true = FinishedSweep(sweep).row(2)
    (marks,) = true["checkpoints"].to_pylist()
    other = pa.array([[*marks[:4], *[0] * 16]], true.schema.field("checkpoints").type)
    row = pa.table({"checkpoints": other})
    monkeypatch.setattr(FinishedSweep, "row", lambda self, episode: row)
    (sentence,) = record(sweep, {2: ("median",)}).values()
    assert "episode 2: what was recorded differs from the table" in sentence
    assert "t = 0.04 s and 0.05 s" in sentence


def test_the_command_records_after_the_sweep_and_when_it_goes_on(tmp_path, capsys, monkeypatch):
    spec, out = tmp_path / "spec.toml", tmp_path / "out"
    spec.write_text(SPEC.replace('["worst", "median", 6]', "[]"))
    command = ["sweep", str(spec), "--out", str(out), "--workers", "1"]
    assert main(command) == 0
    assert not (out / RECORDED).exists()
    spec.write_text(SPEC.replace('["worst", "median", 6]', '["diverged", 6]'))
    assert main([*command, "--resume"]) == 0
    assert recorded(out) == {"6-chosen"}
    assert f"recorded in {out / RECORDED}/: 6 (chosen)" in capsys.readouterr().out
    spec.write_text(SPEC.replace('["worst", "median", 6]', "[3, 8]"))
    assert main([*command, "--resume"]) == 2
    err = capsys.readouterr().err
    assert err == f"octarm: {spec}, line 17: there is no episode 8; they are numbered 0 .. 7\n"
    spec.write_text(SPEC.replace('["worst", "median", 6]', "[3]"))

    def interrupted(*_args, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr(episodes, "run_into", interrupted)
    assert main([*command, "--resume"]) == 130
    assert capsys.readouterr().err.strip().endswith("--workers=1 --resume goes on")

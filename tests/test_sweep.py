"""A sweep gives one table, however and by whom it is run, and whatever happens meanwhile."""

import dataclasses
import errno
import os
import random
import subprocess
import sys
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from importlib.metadata import version
from pathlib import Path

import pyarrow as pa
import pytest

import octarm
from controllers import make_controller
from octarm.checks.verify import check_episode
from octarm.errors import OctarmError
from octarm.sweeps.episodes import FinishedSweep
from octarm.sweeps.execute import estimate
from octarm.sweeps.plan import Plan
from octarm.sweeps.shards import run_arms
from octarm.sweeps.spec_file import parse_spec
from octarm.sweeps.store import MANIFEST, open_sweep, origin_of
from octarm.sweeps.workers import WorkerProcesses

SPEC = """\
seed = 1
episodes = 3
duration = 0.02
batch = 4
[grid]
controller = ["smc-boundary", "pd"]
mismatch = [-0.3, 0.3]
[grid.disturbance]
noise = [0.0, 0.4]
"""
SHARDS = 6


class Inline(Executor):
    """Does what it is asked for at once, in this thread."""

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def rows(folder: Path) -> pa.Table:
    return octarm.read_sweep(folder).drop_columns("wall_time")


def run(folder: Path, text: str = SPEC, **options) -> pa.Table:
    octarm.sweep(
        parse_spec(text),
        make_controller,
        folder,
        **{"executor": Inline(), "in_flight": 1} | options,
    )
    return rows(folder)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> pa.Table:
    return run(tmp_path_factory.mktemp("undisturbed") / "sweep")


def test_there_is_a_row_an_episode(undisturbed):
    assert undisturbed["episode"].to_pylist() == list(range(24))
    assert undisturbed["seed"].to_pylist() == [0, 1, 2] * 8
    assert undisturbed["mismatch"].to_pylist() == ([-0.3] * 6 + [0.3] * 6) * 2
    assert undisturbed["noise"].to_pylist() == ([0.0] * 3 + [0.4] * 3) * 4
    assert undisturbed["controller"].to_pylist() == ["smc-boundary"] * 12 + ["pd"] * 12
    assert undisturbed["reference"].to_pylist() == ["sine"] * 24
    assert undisturbed.column("digest").null_count == 0
    assert len(set(undisturbed["digest"].to_pylist())) == 2 * 2 * (1 + 3)  # seeds matter to noise


def test_a_row_is_that_of_the_episode_run_alone(undisturbed):
    plan = Plan(parse_spec(SPEC))
    alone = run_arms(plan, plan.episode(17), make_controller).drop_columns("wall_time")
    assert alone.equals(undisturbed.slice(17, 1))


def test_the_table_is_the_same_on_threads_and_in_any_order(tmp_path, undisturbed):
    class Reversed(Inline):
        """Answers the last call first."""

        def __init__(self):
            self.calls = []

        def submit(self, fn, /, *args, **kwargs):
            future = Future()
            self.calls.append((future, fn, args))
            if len(self.calls) == SHARDS:
                for earlier, function, given in reversed(self.calls):
                    earlier.set_result(function(*given))
            return future

    assert run(tmp_path / "reversed", executor=Reversed(), in_flight=SHARDS).equals(undisturbed)
    with ThreadPoolExecutor(2) as threads:
        assert run(tmp_path / "threads", executor=threads, in_flight=3).equals(undisturbed)


def test_the_table_is_the_same_in_a_process(tmp_path, undisturbed):
    with WorkerProcesses(1) as process:
        assert run(tmp_path / "s", executor=process, in_flight=2).equals(undisturbed)


def test_a_shard_that_kills_its_workers_fails_alone(tmp_path, undisturbed):
    class Deadly(Inline):
        def submit(self, fn, /, *args, **kwargs):
            if args[1] != 2:
                return super().submit(fn, *args, **kwargs)
            future = Future()
            future.set_exception(BrokenProcessPool("gone"))
            return future

    with pytest.raises(
        OctarmError, match=r"shard 2 failed: its worker died 4 times; shards left to do: 1"
    ):
        run(tmp_path / "s", executor=Deadly())
    numbers = rows(tmp_path / "s")["episode"].to_pylist()
    assert numbers == [*range(8), *range(12, 24)]
    assert run(tmp_path / "s", resume=True).equals(undisturbed)


def test_an_error_in_shards_ends_the_sweep_soon_and_keeps_the_rest(tmp_path, undisturbed):
    calls = []

    class Failing(Inline):
        def submit(self, fn, /, *args, **kwargs):
            calls.append(args[1])
            if args[1] > 0:
                fn = failing
            return super().submit(fn, *args, **kwargs)

    def failing(*_):
        raise ArithmeticError("no such\nnumber")

    with pytest.raises(RuntimeError, match=r"shard 1 failed: no such number; .*--resume"):
        run(tmp_path / "s", executor=Failing())
    assert len(calls) < SHARDS
    assert run(tmp_path / "s", resume=True).equals(undisturbed)


def test_resume_runs_what_is_missing_or_damaged_and_nothing_else(tmp_path, undisturbed):
    folder = tmp_path / "s"
    run(folder)
    files = [folder / "episodes" / f"{i:05d}.parquet" for i in range(SHARDS)]
    files[0].unlink()
    files[1].write_bytes(files[1].read_bytes()[:-100])
    content = bytearray(files[2].read_bytes())
    content[random.randrange(len(content))] ^= 1  # tests/test_sweep_files.py tries them all
    files[2].write_bytes(content)
    files[3].write_bytes(files[4].read_bytes())
    before = {file: file.stat().st_mtime_ns for file in files[4:]}
    with pytest.raises(ValueError, match=r"00001.parquet is damaged"):
        octarm.read_sweep(folder)
    done = []
    assert run(folder, resume=True, progress=done.append).equals(undisturbed)
    assert sorted({*done}) == [8, 12, 16, 20, 24]
    assert {file: file.stat().st_mtime_ns for file in files[4:]} == before
    assert len(open_sweep(folder)[1]["starts"]) == 2


def test_resume_begins_a_sweep_that_was_not_begun(tmp_path, undisturbed):
    assert run(tmp_path / "new" / "s", resume=True).equals(undisturbed)


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("seed = 1", "seed = 2", "seed is 1 there and is 2 here"),
        ("[0.0, 0.4]", "[0.0, 0.8]", r"grid.noise is \[0.0, 0.4\] there and is \[0.0, 0.8\] here"),
        ("[grid]", "[gains.pd]\nK_p = 9\n[grid]", "gains.pd.K_p is not given there and is 9.0"),
    ],
)
def test_a_changed_spec_is_refused_with_the_difference(tmp_path, old: str, new: str, told: str):
    run(tmp_path / "s")
    with pytest.raises(ValueError, match=told):
        run(tmp_path / "s", SPEC.replace(old, new), resume=True)
    with pytest.raises(ValueError, match="holds a sweep already; go on with it by --resume"):
        run(tmp_path / "s")


def test_other_gains_are_refused(tmp_path):
    spec = 'controller = "smc-boundary"\nduration = 0.002'
    run(tmp_path / "s", spec)
    with pytest.raises(ValueError, match="begun with other gains of smc-boundary"):
        octarm.sweep(
            parse_spec(spec),
            lambda name, nominal, gains: make_controller(name, nominal, {"lambda": 1.0, **gains}),
            tmp_path / "s",
            executor=Inline(),
            resume=True,
        )


def test_the_gain_set_of_a_spec_is_used_and_written_down(tmp_path):
    asked = []

    def factory(name, nominal, gains, *, gain_set=None):
        asked.append((name, gain_set))
        return make_controller(name, nominal, gains, gain_set=gain_set)

    text = 'duration = 0.002\n[grid]\ncontroller = ["pd", "smc"]\n[gain_set]\npd = "recommended"'
    folder = octarm.sweep(parse_spec(text), factory, tmp_path / "s", executor=Inline())
    assert set(asked) == {("pd", "recommended"), ("smc", None)}
    assert open_sweep(folder)[1]["spec"]["gain_set.pd"] == "recommended"
    asked.clear()
    assert check_episode(FinishedSweep(folder), 0, factory).identical
    assert set(asked) == {("pd", "recommended")}
    with pytest.raises(ValueError, match=r"gain_set.pd is \"recommended\" there and is not given"):
        run(folder, text[: text.index("[gain_set]")], resume=True)


def test_a_spec_that_cannot_run_leaves_no_folder(tmp_path):
    for old, new in (("pd", "dp"), ("[grid]", "[gains.pd]\nK_q = 9\n[grid]")):
        with pytest.raises(ValueError, match=r"unknown controller 'dp'|no gain 'K_q'"):
            run(tmp_path / "s", SPEC.replace(old, new))
    late = SPEC + "[disturbance]\nnoise.time = 0.0001"  # shorter than a physics step
    with pytest.raises(ValueError, match="correlation time"):
        run(tmp_path / "s", late)
    assert not list(tmp_path.iterdir())


def test_other_folders_are_left_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    for resume in (False, True):
        with pytest.raises(ValueError, match="exists and is not a sweep"):
            run(tmp_path, resume=resume)
    with pytest.raises(ValueError, match="is not a folder"):
        run(tmp_path / "mine.txt")
    assert [file.name for file in tmp_path.iterdir()] == ["mine.txt"]
    with pytest.raises(ValueError, match=f"is not a sweep: it has no {MANIFEST}"):
        octarm.read_sweep(tmp_path)


def test_two_at_once_do_not_get_into_each_others_way(tmp_path):
    refused = []

    def another(done: int) -> None:
        if done and not refused:
            with pytest.raises(ValueError, match="another process is at work") as caught:
                run(tmp_path / "s", resume=True)
            refused.append(caught)

    run(tmp_path / "s", progress=another)
    assert refused


def test_a_full_disk_is_one_sentence_and_costs_no_finished_shard(
    tmp_path, monkeypatch, undisturbed
):
    write, written = Path.write_bytes, []

    def fill_up(self, data):
        if len(written) == 2:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self))
        written.append(self)
        return write(self, data)

    monkeypatch.setattr(Path, "write_bytes", fill_up)
    with pytest.raises(OSError, match=r"00002.parquet cannot be written: No space left"):
        run(tmp_path / "s")
    monkeypatch.undo()
    assert sorted(os.listdir(tmp_path / "s" / "episodes")) == ["00000.parquet", "00001.parquet"]
    done = []
    assert run(tmp_path / "s", resume=True, progress=done.append).equals(undisturbed)
    assert done[0] == 8


def test_the_manifest_says_what_was_run(tmp_path, undisturbed):
    run(tmp_path / "s")
    assert (tmp_path / "s" / "spec.toml").read_text() == SPEC
    manifest = open_sweep(tmp_path / "s")[1]
    assert manifest["spec_hash"] == parse_spec(SPEC).hash()
    assert manifest["episodes"] == len(undisturbed)
    assert sum(shard["episodes"] for shard in manifest["shards"]) == len(undisturbed)
    assert set(manifest["gains"]) == {"smc-boundary", "pd"}
    assert {"mujoco", "numpy", "octarm"} <= set(manifest["starts"][0]["versions"])


def test_a_shard_says_where_it_was_run(tmp_path):
    run(tmp_path / "s")
    sweep = FinishedSweep(tmp_path / "s")
    facts = origin_of(sweep.row(23))
    assert facts["versions"]["octarm"] == version("octarm")
    assert facts["host"]["cores"] == os.cpu_count()
    with pytest.raises(ValueError, match="there is no episode 24"):
        sweep.row(24)
    (tmp_path / "s" / sweep.manifest["shards"][-1]["file"]).unlink()
    with pytest.raises(ValueError, match=r"episode 23 of .* is not finished"):
        sweep.row(23)


def test_a_spec_that_was_changed_after_reading_is_kept_as_it_was_run(tmp_path):
    spec = dataclasses.replace(parse_spec(SPEC), episodes=1)
    folder = octarm.sweep(spec, make_controller, tmp_path / "s", executor=Inline())
    assert octarm.read_spec(folder / "spec.toml").hash() == spec.hash()


def test_chosen_columns_are_read_alone(tmp_path):
    run(tmp_path / "s")
    table = octarm.read_sweep(tmp_path / "s", ["controller", "effort_tau1"])
    assert table.column_names == ["controller", "effort_tau1"]
    assert table.schema.field("effort_tau1").metadata[b"unit"] == b"N"


def test_an_estimate_counts_episodes_and_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    expected = estimate(parse_spec(SPEC), make_controller)
    assert (expected.episodes, expected.shards) == (24, SHARDS)
    assert expected.seconds > 0.0 and expected.size > 0
    assert not list(tmp_path.iterdir())


# --- memory ----------------------------------------------------------------------------------

MEASURE = """
import resource, sys
from pathlib import Path
sys.path.insert(0, "tests")
from test_sweep import SPEC, Inline
import octarm
from controllers import make_controller
from octarm.sweeps.spec_file import parse_spec
spec = SPEC.replace("batch = 4", "batch = 200")
CASES = [(100, 0.0005), (100, 0.0005), (1000, 0.0005), (100, 0.04)]
for i, (episodes, duration) in enumerate(CASES):
    text = spec.replace("episodes = 3", f"episodes = {episodes}").replace("0.02", str(duration))
    octarm.sweep(parse_spec(text), make_controller, Path("%s") / str(i), executor=Inline(),
                 in_flight=1)
    print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0)
"""


def test_memory_grows_neither_with_episodes_nor_with_their_length(tmp_path):
    done = subprocess.run(
        [sys.executable, "-c", MEASURE % tmp_path], cwd=Path(__file__).parent.parent,
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    _, before, *after = map(float, done.stdout.split())
    assert max(after) - before < 15.0  # [MB]

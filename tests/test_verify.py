"""What was run comes out again bit by bit, and a difference is found where it is."""

import dataclasses
import functools
import hashlib
import json
import shutil
import subprocess
import sys
from concurrent.futures import Executor, Future
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from recordings import write_run
from test_disturbances import SPELLINGS

import octarm
from controllers import CONTROLLERS, make_controller
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.checks.differences import compare
from octarm.checks.verify import RunCheck, check_episode, check_run
from octarm.commands.cli import main
from octarm.disturbances.spelling import parse_disturbance
from octarm.runs.digest import CHECKPOINTS
from octarm.runs.experiment import Experiment, perform
from octarm.simulation.trajectory import Trajectory
from octarm.sweeps.episodes import FinishedSweep, first_difference
from octarm.sweeps.spec_file import parse_spec
from octarm.sweeps.store import RECORDED, shard_bytes

P = nominal_parameters()
FACTORY = functools.partial(make_controller, gain_set="recommended")


def experiment(**changes) -> Experiment:
    plain = {
        "controller": "smc-boundary",
        "gains": {},
        "nominal": P.mismatched(-0.3),
        "parameters": P,
        "reference": "sine",
        "duration": 0.03,
    }
    return Experiment(**(plain | changes))


def write(folder: Path, what: Experiment, **options) -> Trajectory:
    """A run folder, its recording aside."""
    environment, controller = what.begin(make_controller)
    announced = what.announcement(environment, controller)
    trajectory, description = perform(environment, controller, announced, **options)
    folder.mkdir(exist_ok=True)
    write_run(folder, trajectory, description)
    return trajectory


def check(folder: Path) -> RunCheck:
    return check_run(folder, FACTORY)


def edit(folder: Path, *keys, to) -> None:
    """Changes an entry of run.json."""
    description = json.loads((folder / "run.json").read_text())
    table = description
    for key in keys[:-1]:
        table = table[key]
    table[keys[-1]] = to(table[keys[-1]])
    (folder / "run.json").write_text(json.dumps(description))


def flip(folder: Path, name: str, place: tuple[int, ...]) -> None:
    """Turns the last bit of one number in run.npz."""
    with np.load(folder / "run.npz") as file:
        content = dict(file)
    content[name].view(np.uint64)[place] ^= np.uint64(1)
    np.savez(folder / "run.npz", **content)


@pytest.fixture(scope="module")
def original(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("original") / "run"
    noise = parse_disturbance("noise:0.4,time=0.003")
    write(folder, experiment(disturbances=(noise, noise), seed=7, duration=0.1))
    return folder


@pytest.fixture
def run(original, tmp_path) -> Path:
    return shutil.copytree(original, tmp_path / "run")


@pytest.mark.parametrize("name", SPELLINGS)
def test_a_run_under_any_disturbance_comes_out_again(name, tmp_path):
    disturbances = (parse_disturbance(SPELLINGS[name]),)
    write(tmp_path / "run", experiment(disturbances=disturbances, seed=3))
    found = check(tmp_path / "run")
    assert found.identical, found.lines()
    assert "bit for bit" in found.lines()[0]


@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_run_of_any_controller_comes_out_again(name, tmp_path):
    write(tmp_path / "run", experiment(controller=name, nominal=P.mismatched(0.1 / 3.0)))
    assert check(tmp_path / "run").identical


def test_everything_that_can_be_chosen_is_written_down(tmp_path):
    what = experiment(
        gains={"lambda": 10.0 / 3.0, "K": np.array([1.0, 1.0, 1.0, 0.1, 0.1, 1.0 / 7.0])},
        nominal=P.mismatched(-0.2).scaled(mass=[1.1, 0.9, 1.0]),
        parameters=P.scaled(damping=1.0 / 3.0),
        reference="smooth-step",
        disturbances=tuple(map(parse_disturbance, SPELLINGS.values())),
        seed=12,
        spawn_key=(5,),
        timestep=0.001 / 3.0,
        control_period=0.001,
        actuation="internal",
    )
    first = write(tmp_path / "run", what)
    assert check(tmp_path / "run").identical
    again = Experiment.from_description(json.loads((tmp_path / "run/run.json").read_text()))
    assert write(tmp_path / "again", again).digest == first.digest


def test_an_arm_of_any_length_comes_out_again(tmp_path):
    fields = {name: np.array(getattr(P, name)) for name in P.to_dict()}
    short = ArmParameters(**{name: x[..., :2] if x.ndim else x for name, x in fields.items()})
    noise = (parse_disturbance("noise:0.4"),)
    write(tmp_path / "run", experiment(parameters=short, nominal=short, disturbances=noise))
    assert check(tmp_path / "run").identical
    flip(tmp_path / "run", "v", (9, 3))
    assert check(tmp_path / "run").deviations[0].place == "theta2"


def test_a_run_that_diverged_comes_out_again(tmp_path):
    gains = {"K": [1600.0, 1000.0, 800.0, 400.0, 250.0, 30.0]}
    strong = dataclasses.replace(P, input_range=(-np.inf, np.inf))
    what = experiment(gains=gains, duration=0.5, parameters=strong)
    trajectory = write(tmp_path / "run", what)
    assert trajectory.status == "diverged"
    metrics = json.loads((tmp_path / "run/run.json").read_text())["metrics"]
    assert metrics["effort"] == [None] * 6 and metrics["tip_rms_error"] is None
    assert check(tmp_path / "run").identical
    edit(tmp_path / "run", "message", to=lambda text: text.replace("diverged", "turned"))
    found = check(tmp_path / "run")
    assert [d.key for d in found.differences] == ["message", "sha256.run.json"]


def test_a_run_that_was_interrupted_comes_out_again(tmp_path):
    calls = []

    def progress() -> None:
        calls.append(None)
        if len(calls) == 41:
            raise KeyboardInterrupt

    what = experiment(disturbances=(parse_disturbance("noise:0.4"),), duration=60.0)
    trajectory = write(tmp_path / "run", what, progress=progress)
    assert (trajectory.status, len(trajectory)) == ("interrupted", 41)
    assert check(tmp_path / "run").identical
    flip(tmp_path / "run", "q", (40, 0))
    assert check(tmp_path / "run").deviations[0].row == 40


@pytest.mark.parametrize(
    ("array", "place", "of"),
    [
        ("q", (117, 4), "theta2"),
        ("v", (0, 0), "s1"),
        ("tau", (199, 5), "tau6"),
        ("disturbance", (3, 2), "s3"),
        ("s", (64, 3), "theta1"),
        ("V", (8, 0), "0"),
        ("t", (50,), "-"),
    ],
)
def test_one_bit_is_found_in_any_array(run, array, place, of):
    flip(run, array, place)
    (found,) = check(run).deviations
    assert (found.array, found.row, found.place) == (array, place[0], of)
    assert found.t == pytest.approx(place[0] * 5e-4)
    assert 0.0 < found.largest == abs(found.was - found.now)
    stored = Trajectory.load(run / "run.npz")
    known = dict(stored.arrays())
    assert found.was == known[array][place]


def test_where_an_array_was_changed_is_said(run, capsys):
    flip(run, "v", (117, 4))
    assert main(["verify", str(run)]) == 1
    out = capsys.readouterr().out
    stored = float(Trajectory.load(run / "run.npz").v[117, 4])
    assert (
        f"different from t = 0.0585 s on, control instant 117 of 200: v of theta2 was {stored!r}"
        in out
    )
    assert "sha256.run.npz" in out and "sha256.run.json" not in out


def test_a_zero_that_lost_its_sign_is_a_difference(run):
    with np.load(run / "run.npz") as file:
        content = dict(file)
    place = tuple(np.argwhere(content["q_d"] == 0.0)[0])
    content["q_d"][place] = -0.0
    np.savez(run / "run.npz", **content)
    (found,) = check(run).deviations
    assert (found.array, found.row) == ("q_d", place[0])


def slightly(x):
    """The next number, or that of the last entry."""
    return [*x[:-1], slightly(x[-1])] if isinstance(x, list) else float(np.nextafter(x, np.inf))


@pytest.mark.parametrize(
    ("keys", "to"),
    [
        (("controller", "gains", "K"), slightly),
        (("controller", "gains", "lambda_"), slightly),
        (("controller", "name"), lambda _: "smc-integral"),
        (("parameters", "mass"), slightly),
        (("parameters", "gravity"), slightly),
        (("nominal", "stiffness"), slightly),
        (("reference", "name"), lambda _: "multi-sine"),
        (("disturbances", 1, "asked", "ratio"), slightly),
        (("disturbances", 0, "asked", "correlation_time"), lambda x: 2.0 * x),
        (("disturbances",), lambda rows: rows[:1]),
        (("seed",), lambda x: x + 1),
        (("spawn_key",), lambda _: [1]),
        (("timestep",), lambda x: 0.5 * x),
        (("actuation",), lambda _: "internal"),
    ],
)
def test_any_other_input_is_found_out(run, keys, to):
    edit(run, *keys, to=to)
    found = check(run)
    assert found.deviations
    assert {"digest", "digest in run.npz"} <= {d.key for d in found.differences}


def test_the_earliest_difference_comes_first(run):
    edit(run, "controller", "gains", "K", to=slightly)
    rows = [d.row for d in check(run).deviations]
    assert rows == sorted(rows)
    first = check(run).deviations[0]
    assert first.array in ("switching", "force", "tau")  # what a gain acts on, before the motion


@pytest.mark.parametrize(
    ("keys", "key"),
    [
        (("metrics", "effort", 3), "metrics.effort[3]"),
        (("reference", "amplitude", 3), "reference.amplitude[3]"),
        (("disturbances", 0, "delivered", "rms", 2), "disturbances[0].delivered.rms[2]"),
    ],
)
def test_what_run_json_says_beside_is_compared_too(run, keys, key):
    edit(run, *keys, to=slightly)
    found = check(run)
    assert not found.identical
    assert [d.key for d in found.differences] == [key, "sha256.run.json"]
    assert "q and v are the same" in found.lines()[0]


def test_another_digest_is_found_out(run):
    edit(run, "digest", to=lambda text: text[::-1])
    found = check(run)
    assert not found.identical and not found.deviations
    assert [d.key for d in found.differences] == ["digest", "sha256.run.json"]


def test_rows_that_are_missing_are_found_out(run):
    with np.load(run / "run.npz") as file:
        content = {k: x[:150] if x.ndim else x for k, x in file.items() if k != "s"}
    np.savez(run / "run.npz", **content)
    found = check(run)
    assert [(d.key, d.was, d.now) for d in found.differences[:2]] == [
        ("rows", 150, 200),
        ("form of s", "absent", "<f8 (6,) by rows"),
    ]


def test_versions_and_machine_of_both_sides_are_said(run):
    edit(run, "versions", "numpy", to=lambda _: "1.0")
    edit(run, "host", "kernels", to=lambda _: "ABACUS")
    assert check(run).identical
    edit(run, "seed", to=lambda x: x + 1)
    lines = check(run).lines()
    marked = [line.split() for line in lines if line.startswith("*")]
    assert marked[0] == ["*", "numpy", "1.0", np.__version__]
    assert marked[1][:3] == ["*", "kernels", "ABACUS"] and len(marked) == 2


def test_a_run_comes_out_again_in_another_process(original):
    command = [sys.executable, "-m", "octarm", "verify", str(original)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=1800, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert "identical: 200 control instants" in done.stdout


def test_what_cannot_be_repeated_is_said_in_a_sentence(run, capsys, tmp_path):
    def sentence(*arguments) -> str:
        assert main(["verify", *map(str, arguments)]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        return line

    assert "is no sweep; --episode" in sentence(run, "--episode", 1)
    assert "nothing to verify" in sentence()
    assert "is not a run folder" in sentence(tmp_path)
    edit(run, "reference", "name", to=lambda _: "my-own")
    assert "the run followed a custom reference, 'my-own'" in sentence(run)
    edit(run, "reference", to=lambda _: None)
    assert "run.json: reference is null; it must be a table" in sentence(run)
    edit(run, "reference", to=lambda _: {"name": "sine"})
    description = json.loads((run / "run.json").read_text())
    del description["nominal"]
    (run / "run.json").write_text(json.dumps(description))
    assert "run.json: it needs a value of nominal" in sentence(run)
    (run / "run.npz").unlink()
    assert "has no run.npz to compare with: it is incomplete" in sentence(run)
    edit(run, "status", to=lambda _: "running")
    assert "still going on or was killed" in sentence(run)


def test_numbers_are_the_same_when_their_bits_are():
    assert not list(compare({"a": [0.0, None, "x"]}, {"a": [0.0, None, "x"]}))
    keys = [d.key for d in compare({"a": [0.0, {"b": 1.0}], "c": 1}, {"a": [-0.0, {}], "c": None})]
    assert keys == ["a[0]", "a[1].b", "c"]


# Episodes of a sweep.

SPEC = """\
seed = 1
episodes = 2
duration = 0.02
batch = 8
[grid]
controller = ["smc-boundary", "afsmc"]
mismatch = [-0.3, 0.3]
[grid.disturbance]
noise = [0.0, 0.4]
[random.disturbance]
payload = { low = 0.0, high = 0.3 }
"""


class Inline(Executor):
    """Does what it is asked for at once, in this thread."""

    def submit(self, fn, /, *args, **kwargs):
        future = Future()
        future.set_result(fn(*args, **kwargs))
        return future


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("sweep") / "sweep"
    octarm.sweep(parse_spec(SPEC), make_controller, folder, executor=Inline(), in_flight=1)
    return folder


@pytest.fixture
def sweep(finished, tmp_path) -> Path:
    return shutil.copytree(finished, tmp_path / "sweep")


def doctor(folder: Path, episode: int, column: str, value) -> None:
    """Changes a number in the table."""
    file = folder / f"episodes/{episode // 8:05d}.parquet"
    table = pq.read_table(file)
    values = table[column].to_pylist()
    values[episode % 8] = value(values[episode % 8])
    at = table.schema.get_field_index(column)
    field = table.schema.field(column)
    table = table.set_column(at, field, pa.array(values, field.type))
    file.write_bytes(content := shard_bytes(table))
    manifest = json.loads((folder / "manifest.json").read_text())
    manifest["shards"][episode // 8]["sha256"] = hashlib.sha256(content).hexdigest()
    (folder / "manifest.json").write_text(json.dumps(manifest))


def test_every_episode_of_a_batch_comes_out_again_alone(finished):
    sweep = FinishedSweep(finished)
    assert sweep.finished().tolist() == list(range(16))
    found = check_episode(sweep, 15, make_controller)
    for episode in range(15):
        each = check_episode(sweep, episode, make_controller)
        assert each.identical, each.lines()
    assert found.identical
    assert found.label.startswith("afsmc, sine, mismatch 0.3, noise 0.4, payload 0.")
    assert found.label.endswith("seed 1")


def test_the_first_checkpoint_that_differs_is_found(sweep):
    def change(marks: list[int]) -> list[int]:
        return [*marks[:13], *(mark ^ 1 for mark in marks[13:])]

    doctor(sweep, 10, "checkpoints", change)
    found = check_episode(FinishedSweep(sweep), 10, make_controller)
    assert not found.identical
    assert found.between == pytest.approx((0.013, 0.014))  # 20 of them in 0.02 s
    assert found.recorded is None
    (sweep / RECORDED / "10-worst").mkdir(parents=True)
    lines = check_episode(FinishedSweep(sweep), 10, make_controller).lines()
    assert f"octarm verify {sweep / RECORDED / '10-worst'} says from which one on" in lines[1]
    assert check_episode(FinishedSweep(sweep), 11, make_controller).identical


def test_the_checkpoint_narrows_where_motions_part():
    was = list(range(CHECKPOINTS))
    assert first_difference(was, was, 10.0) is None
    assert first_difference(was, [*was[:-1], 0], 10.0) == (9.5, 10.0)
    assert first_difference(was, [1, *was[1:]], 10.0) == (0.0, 0.5)


def test_a_measure_that_was_changed_is_found(sweep):
    doctor(sweep, 3, "energy_s2", slightly)
    found = check_episode(FinishedSweep(sweep), 3, make_controller)
    assert found.between is None
    assert [d.key for d in found.differences] == ["energy_s2"]
    assert "the motion is the same" in found.lines()[0]


def test_the_command_verifies_episodes(sweep, capsys):
    assert main(["verify", str(sweep), "--episode", "3", "--episode", "9"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split("(")[0] for line in lines] == [
        f"{sweep}: episode 3 ",
        f"{sweep}: episode 9 ",
    ]
    doctor(sweep, 9, "digest", lambda x: x ^ 1)
    assert main(["verify", str(sweep), "--sample", "100"]) == 1
    lines = capsys.readouterr().out.splitlines()
    assert sum("identical when run alone" in line for line in lines) == 15
    assert sum("episode 9" in line for line in lines) == 1
    assert any(line.split()[:2] == ["mujoco", line.split()[-1]] for line in lines)


def test_what_cannot_be_verified_of_a_sweep_is_said_in_a_sentence(sweep, capsys):
    def sentence(*arguments) -> str:
        assert main(["verify", str(sweep), *arguments]) == 2
        out, err = capsys.readouterr()
        assert out == ""
        (line,) = err.splitlines()
        return line

    assert "is a sweep; --episode N says which of its 16" in sentence()
    assert "there is no episode 16; they are numbered 0 .. 15" in sentence("--episode", "16")
    assert "episode is -1; it must be at least 0" in sentence("--episode", "-1")
    assert "sample is 0; it must be at least 1" in sentence("--sample", "0")
    (sweep / "episodes/00001.parquet").unlink()
    assert "episode 8 of" in sentence("--episode", "0", "--episode", "8")
    spec = sweep / "spec.toml"
    spec.write_text(spec.read_text().replace("seed = 1", "seed = 2"))
    assert "spec.toml was changed" in sentence("--episode", "0")


@pytest.mark.parametrize("change", [lambda layer: np.nextafter(layer, 1.0), lambda layer: None])
def test_another_boundary_layer_is_found(change, tmp_path):
    write(tmp_path / "run", experiment())
    with np.load(tmp_path / "run" / "run.npz") as file:
        content = dict(file)
    changed = change(content.pop("layer"))
    np.savez(
        tmp_path / "run" / "run.npz", **content, **({} if changed is None else {"layer": changed})
    )
    checked = check(tmp_path / "run")
    assert not checked.identical
    assert "layer" in "\n".join(checked.lines())

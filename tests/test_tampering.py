"""Whatever is changed in a run or a sweep is noticed, also when the SHA-256s were made anew."""

import copy
import functools
import hashlib
import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import rerun as rr

import octarm
from controllers import make_controller
from octarm.checks.differences import sweep_differences
from octarm.checks.verify import RunCheck, check_run
from octarm.commands.cli import main
from octarm.errors import OctarmError
from octarm.recordings.rrd import contents, rrd_file
from octarm.runs import folder as runs
from octarm.sweeps.episodes import FinishedSweep
from octarm.sweeps.spec_file import parse_spec
from octarm.sweeps.store import shard_bytes

FACTORY = functools.partial(make_controller, gain_set="recommended")


def read(file: Path) -> dict:
    return json.loads(file.read_text())


def restate(folder: Path) -> None:
    """Makes the checksums of a run anew, as whoever changes it on purpose would."""
    content = read(folder / "run.json")
    content["sha256"] = runs.checksums(folder, content)
    (folder / "run.json").write_text(json.dumps(content))


def changed(value):
    """Another value of the same kind."""
    match value:
        case bool():
            return not value
        case int():
            return value + 1
        case float():
            return float(np.nextafter(value, np.inf))
        case str():
            return value + "x"
        case dict():
            return {**value, "unknown": 1}
        case list():
            return [*value, 1]
        case _:
            return 1.0


def places(content, above=(), turn=None):
    """The keys of all entries, those in lists included.

    If a turn is given, of a list of plain values it is one alone, and the next one in each turn;
    lists with names of different lengths begin with different ones.
    """
    first = (turn or 0) + len(str(above))
    for key, value in content.items() if isinstance(content, dict) else enumerate(content):
        nested = isinstance(value, dict | list)
        if nested or turn is None or isinstance(content, dict) or key == first % len(content):
            yield (*above, key)
        if nested:
            yield from places(value, (*above, key), turn)


def altered(content: dict, place: tuple, how: str) -> dict:
    """A copy with one entry changed, deleted, or with another one beside it."""
    content = copy.deepcopy(content)
    *above, key = place
    table = content
    for name in above:
        table = table[name]
    if how == "changed":
        table[key] = changed(table[key])
    elif how == "deleted":
        del table[key]
    elif isinstance(table, dict):
        table["absent"] = "absent"
    else:
        table.insert(key, table[key])
    return content


def flipped(file: Path, place: float) -> None:
    content = bytearray(file.read_bytes())
    content[int(place * (len(content) - 1))] ^= 1 << int(8 * place) % 8
    file.write_bytes(content)


FILES = {
    "its first byte": lambda file, other: flipped(file, 0.0),
    "a byte amid it": lambda file, other: flipped(file, 0.6),
    "its last byte": lambda file, other: flipped(file, 1.0),
    "emptied": lambda file, other: file.write_bytes(b""),
    "cut": lambda file, other: file.write_bytes(file.read_bytes()[:-3]),
    "doubled": lambda file, other: file.write_bytes(2 * file.read_bytes()),
    "deleted": lambda file, other: file.unlink(),
    "swapped": lambda file, other: shutil.copy(other, file),
    "a folder": lambda file, other: (file.unlink(), file.mkdir()),
}


# --- runs --------------------------------------------------------------------------------------


def made(folder: Path, *options: str) -> Path:
    command = ["run", "--controller", "smc-boundary", "--duration", "0.02", "--out", str(folder)]
    assert main([*command, *options]) == 0
    return folder


@pytest.fixture(scope="module")
def original(tmp_path_factory) -> Path:
    return made(tmp_path_factory.mktemp("original") / "run", "--disturbance", "noise:0.4")


@pytest.fixture(scope="module")
def calm(tmp_path_factory) -> Path:
    """A run in which nothing random acts: another seed gives the same motion."""
    return made(tmp_path_factory.mktemp("calm") / "run", "--seed", "3")


@pytest.fixture
def run(original, tmp_path) -> Path:
    return shutil.copytree(original, tmp_path / "run")


def check(folder: Path) -> RunCheck | None:
    """The comparison; None if the folder is refused in a sentence."""
    try:
        return check_run(folder, FACTORY)
    except OctarmError:
        return None


def noticed(folder: Path) -> bool:
    found = check(folder)
    if found is not None and not found.identical:
        lines = found.lines()
        assert lines[0].startswith("different") and len(lines) > 2
    return found is None or not found.identical


def test_what_was_not_changed_is_identical(run, calm, tmp_path):
    for folder in (run, calm):
        found = check(folder)
        assert found is not None and found.identical
        assert "the recording and run.json, bit for bit" in found.lines()[0]
    moved = shutil.move(run, tmp_path / "elsewhere")
    assert not noticed(Path(moved))


PLACES = [  # of each table those entries that are of its first kinds
    "format", "controller.name", "controller.gains", "controller.gains.lambda_",
    "controller.gains.phi.2", "parameters.mass.0", "parameters.gravity", "coordinates.3.unit",
    "nominal.width", "reference.amplitude.3", "disturbances.0.name", "disturbances.0.asked.on",
    "disturbances.0.delivered.rms.4", "seed", "spawn_key", "duration", "timestep",
    "control_period", "actuation", "metrics", "metrics.effort.5", "metrics.tip_rms_error",
    "status", "message", "digest", "command", "sha256.run.json",
]  # fmt: skip


def place_of(content: dict, dotted: str) -> tuple:
    return next(p for p in places(content) if ".".join(map(str, p)) == dotted)


@pytest.mark.parametrize("dotted", PLACES)
def test_an_entry_of_run_json(run, dotted):
    content = read(run / "run.json")
    how = ("changed", "deleted", "added")[PLACES.index(dotted) % 3]  # all of them below
    (run / "run.json").write_text(json.dumps(altered(content, place_of(content, dotted), how)))
    assert noticed(run)


@pytest.mark.slow
@pytest.mark.parametrize("turn", range(6))
def test_every_entry_of_run_json(turn, tmp_path, request):
    """The six variants together alter each of the six numbers that most lists have."""
    which, how = ("original", "calm")[turn // 3], ("changed", "deleted", "added")[turn % 3]
    folder = shutil.copytree(request.getfixturevalue(which), tmp_path / "run")
    content = read(folder / "run.json")
    missed = []
    for place in places(content, turn=turn):
        (folder / "run.json").write_text(json.dumps(altered(content, place, how)))
        if not noticed(folder):
            missed.append(place)
    free = [p for p in places(content) if p[0] in runs.NAMED and len(p) == 2]
    assert missed == (free if how == "changed" else [])


@pytest.mark.parametrize("key", ["versions", "host"])
def test_only_values_of_versions_and_machine_may_differ(run, key):
    content = read(run / "run.json")
    name = next(iter(content[key]))
    (run / "run.json").write_text(json.dumps(altered(content, (key, name), "changed")))
    assert not noticed(run)
    for place, how in (((key,), "deleted"), ((key, name), "deleted"), ((key, name), "added")):
        (run / "run.json").write_text(json.dumps(altered(content, place, how)))
        assert noticed(run)


@pytest.mark.parametrize("key", ["seed", "spawn_key", "command", "duration"])
def test_what_no_repetition_can_tell_is_covered_by_the_checksum(calm, tmp_path, key):
    folder = shutil.copytree(calm, tmp_path / "run")
    content = read(folder / "run.json")
    (folder / "run.json").write_text(json.dumps(altered(content, (key,), "changed")))
    found = check(folder)
    assert found is None or [d.key for d in found.differences][-1:] == ["sha256.run.json"]


def with_array(run: Path, name: str, to) -> None:
    """Changes an array of run.npz; None deletes it."""
    with np.load(run / "run.npz") as file:
        content = dict(file)
    array = to(content.pop(name))
    np.savez(run / "run.npz", **content, **({} if array is None else {name: array}))
    restate(run)


def last_bit(array: np.ndarray) -> np.ndarray:
    if array.dtype.kind == "U":
        return np.asarray(f"{array}x")
    array = np.array(array)
    array.view(np.uint64).flat[-1] ^= np.uint64(1)
    return array


ARRAYS = {
    "a bit": last_bit,
    "big-endian": lambda x: x.astype(x.dtype.newbyteorder(">")),
    "complex": lambda x: x.astype(complex) if x.dtype.kind == "f" else np.asarray(1j),
    "text": lambda x: x.astype(str) if x.dtype.kind == "f" else x.astype("<U99"),
    "half as long": lambda x: x.astype("<f4") if x.dtype.kind == "f" else np.asarray(b"ok"),
    "an axis more": lambda x: x[..., None],
    "fewer rows": lambda x: x[: len(x) // 2] if x.ndim else np.empty(0, x.dtype),
    "more rows": lambda x: np.concatenate([x, x[:1]]) if x.ndim else np.stack([x, x]),
    "reversed": lambda x: x[::-1] if x.ndim and np.any(x) else None,
    "deleted": lambda x: None,
}


@pytest.mark.parametrize("how", ARRAYS)
@pytest.mark.parametrize("name", ["q", "status"])
def test_an_array(run, name, how):
    with_array(run, name, ARRAYS[how])
    assert noticed(run)


@pytest.mark.slow
@pytest.mark.parametrize("how", ARRAYS)
def test_every_array(original, tmp_path, how):
    with np.load(original / "run.npz") as file:
        names = file.files
    for name in names:
        folder = shutil.copytree(original, tmp_path / name)
        with_array(folder, name, ARRAYS[how])
        assert noticed(folder), name


def test_an_array_more_and_bytes_between_arrays(run):
    with np.load(run / "run.npz") as file:
        arrays = dict(file)
    np.savez(run / "run.npz", **arrays, extra=np.zeros(40))
    restate(run)
    found = check(run)
    assert found is None or [d.key for d in found.differences] == ["form of extra"]
    np.savez(run / "run.npz", **arrays)
    restate(run)
    assert not noticed(run)
    np.savez_compressed(run / "run.npz", **arrays)
    found = check(run)
    assert found is not None and [d.key for d in found.differences] == ["sha256.run.npz"]


@pytest.mark.parametrize("how", FILES)
@pytest.mark.parametrize("name", ["run.rrd", "run.npz", "run.json"])
def test_a_file_of_a_run(run, calm, name, how, capsys):
    FILES[how](run / name, calm / name)
    assert noticed(run)
    assert main(["verify", str(run)]) in (1, 2)
    out, err = capsys.readouterr()
    assert "Traceback" not in out + err


@pytest.mark.parametrize("name", ["notes.txt", "run.rrd.part", "run.npz.old", "figures/a.png"])
def test_a_file_more_in_a_run(run, name):
    (run / name).parent.mkdir(exist_ok=True)
    (run / name).touch()
    found = check(run)
    assert found is not None
    assert [d.key for d in found.differences] == [f"file {Path(name).parts[0]}"]


@pytest.mark.parametrize("how", FILES)
def test_a_recording_whose_checksum_was_made_anew(run, calm, how):
    before = contents(run / "run.rrd")
    FILES[how](run / "run.rrd", calm / "run.rrd")
    restate(run)
    if how in ("deleted", "a folder"):
        return  # as a run that was made without
    try:
        alike = [*map(repr, contents(run / "run.rrd").items())] == [*map(repr, before.items())]
    except OctarmError:
        alike = False
    assert noticed(run) or alike  # a byte in rerun's own numbers


def test_a_recording_is_that_of_the_run(run, calm):
    shutil.copy(calm / "run.rrd", run / "run.rrd")
    restate(run)
    found = check(run)
    assert found is not None
    keys = [d.key for d in found.differences]
    assert all(key.startswith("run.rrd /") for key in keys)
    assert "run.rrd /signals octarm:signals" in keys  # without the disturbance
    assert "run.rrd /ledger TextDocument:text" in keys  # which the other one does not have
    assert any(key.startswith("run.rrd /world/tube Cylinders3D:colors, row ") for key in keys)


def test_a_recording_may_be_missing_or_made_again(run, tmp_path, capsys):
    said = (run / "run.json").read_bytes()
    assert main(["record", str(run), "--out", str(tmp_path / "other.rrd")]) == 0
    assert (run / "run.json").read_bytes() == said
    assert main(["record", str(run)]) == 0
    assert not noticed(run)
    (run / "run.rrd").unlink()
    found = check(run)
    assert found is not None
    assert [(d.key, d.now) for d in found.differences] == [("sha256.run.rrd", "absent")]
    restate(run)  # as a run that was never recorded
    found = check(run)
    assert found is not None and found.identical and "recording" not in found.lines()[0]
    shutil.copy(tmp_path / "other.rrd", run / "run.rrd")
    assert noticed(run)
    content = read(run / "run.json")
    (run / "run.json").write_text(json.dumps({**content, "seed": 5}))
    assert main(["record", str(run)]) == 0  # which does not hide that run.json was changed
    assert noticed(run)


def test_an_interrupted_run_is_compared_as_well(tmp_path, original):
    from test_verify import experiment, parse_disturbance, write

    calls = []

    def progress() -> None:
        calls.append(None)
        if len(calls) == 21:
            raise KeyboardInterrupt

    noise = (parse_disturbance("noise:0.4"),)
    write(tmp_path / "run", experiment(disturbances=noise, duration=60.0), progress=progress)
    content = read(tmp_path / "run" / "run.json")
    assert content["duration"] == 60.0 and not noticed(tmp_path / "run")
    for dotted in ("duration", "message", "status", "metrics.effort.0", "disturbances.0.delivered"):
        for how in ("changed", "deleted", "added"):
            altering = altered(content, place_of(content, dotted), how)
            (tmp_path / "run" / "run.json").write_text(json.dumps(altering))
            assert noticed(tmp_path / "run"), (dotted, how)


# --- sweeps ------------------------------------------------------------------------------------

SPEC = """\
# A remark.
gain_set = "recommended"
seed = 1
episodes = 2
duration = 0.02
batch = 4
[grid]
controller = ["pd", "smc-boundary"]
mismatch = [-0.3, 0.3]
[grid.disturbance]
noise = [0.0, 0.4]
[record]
episodes = [3]
"""


def swept(folder: Path, text: str = SPEC) -> Path:
    (folder.parent / "spec.toml").write_text(text)
    command = ["sweep", str(folder.parent / "spec.toml"), "--out", str(folder), "--workers", "1"]
    assert main(command) == 0
    return folder


@pytest.fixture(scope="module")
def finished(tmp_path_factory) -> Path:
    return swept(tmp_path_factory.mktemp("sweep") / "sweep")


@pytest.fixture(scope="module")
def another(tmp_path_factory) -> Path:
    return swept(tmp_path_factory.mktemp("another") / "sweep", SPEC.replace("seed = 1", "seed = 2"))


@pytest.fixture
def sweep(finished, tmp_path) -> Path:
    return shutil.copytree(finished, tmp_path / "sweep")


def refused(folder: Path) -> bool:
    """Whether every reader of a sweep refuses it in a sentence."""
    outcomes = []
    for reading in (
        octarm.read_sweep,
        lambda folder: [FinishedSweep(folder).row(i) for i in range(16)],
        lambda folder: octarm.sweep(
            parse_spec(SPEC), make_controller, folder, executor=ThreadPoolExecutor(1)
        ),
    ):
        try:
            reading(folder)
            outcomes.append(False)
        except OctarmError:
            outcomes.append(True)
    for command in ("report", "verify"):
        more = ["--sample", "1"] if command == "verify" else ["--metric", "effort"]
        outcomes.append(main([command, str(folder), *more]) == 2)
    assert len(set(outcomes)) == 1, outcomes
    return outcomes[0]


def verified(folder: Path, *options: str) -> bool:
    return main(["verify", str(folder), *(options or ("--sample", "1"))]) == 0


def test_a_sweep_that_was_not_changed(sweep, capsys):
    assert verified(sweep, "--sample", "16")
    assert "different" not in capsys.readouterr().out
    assert len(octarm.read_sweep(sweep)) == 16
    assert not sweep_differences(FinishedSweep(sweep), make_controller)


MANIFEST = [
    "format", "spec", "spec.seed", "spec.grid.noise", "spec.grid.noise.0", "spec.gain_set.pd",
    "spec_hash", "spec_sha256", "episodes", "gains", "gains.pd", "gains.pd.K_p.3",
    "gains.smc-boundary.lambda_", "starts", "starts.0", "starts.0.versions", "shards", "shards.1",
    "shards.2.file", "shards.2.first", "shards.2.episodes", "shards.2.sha256",
]  # fmt: skip


@pytest.mark.parametrize("how", ["changed", "deleted", "added"])
@pytest.mark.parametrize("dotted", MANIFEST)
def test_an_entry_of_a_manifest(sweep, dotted, how):
    content = read(sweep / "manifest.json")
    place = next(p for p in places(content) if ".".join(map(str, p)) == dotted)
    (sweep / "manifest.json").write_text(json.dumps(altered(content, place, how)))
    if (dotted, how) in {("starts.0.versions", "changed"), ("starts.0", "added")}:
        return  # as on another machine, and as a sweep that was interrupted
    for reader in (octarm.read_sweep, lambda f: [FinishedSweep(f).row(i) for i in (0, 4, 8, 12)]):
        with pytest.raises(OctarmError):
            reader(sweep)


LISTS = {
    "reversed": lambda x: x[::-1],
    "cut": lambda x: x[:-1],
    "doubled": lambda x: [*x, *x],
    "its last one twice": lambda x: [*x, x[-1]],
    "its first one twice": lambda x: [x[0], *x[:-1]],
    "emptied": lambda x: [],
    "no list": lambda x: {},
}


@pytest.mark.parametrize("how", LISTS)
def test_the_list_of_shards(sweep, how):
    content = read(sweep / "manifest.json")
    content["shards"] = LISTS[how](content["shards"])
    (sweep / "manifest.json").write_text(json.dumps(content))
    assert refused(sweep)


@pytest.mark.parametrize("how", FILES)
@pytest.mark.parametrize("name", ["spec.toml", "manifest.json"])
def test_a_file_that_says_what_was_run(sweep, another, name, how):
    FILES[how](sweep / name, another / name)
    if (name, how) == ("manifest.json", "deleted"):
        assert main(["report", str(sweep)]) == 2  # it is no sweep any more
    else:
        assert refused(sweep)


@pytest.mark.parametrize("how", FILES)
def test_a_shard(sweep, another, how, capsys):
    name = "episodes/00001.parquet"
    FILES[how](sweep / name, another / name)
    assert not verified(sweep, "--episode", "0")
    assert name in capsys.readouterr().out
    if how == "deleted":
        assert main(["report", str(sweep), "--metric", "effort"]) == 0
        assert "not finished: 12 of 16 episodes are there" in capsys.readouterr().out
    else:
        with pytest.raises(OctarmError, match=r"00001.parquet"):
            octarm.read_sweep(sweep, ["episode"])
        assert main(["report", str(sweep), "--metric", "effort"]) == 2


def put_shard(folder: Path, shard: int, content: bytes, *, stated: bool) -> None:
    (folder / f"episodes/{shard:05d}.parquet").write_bytes(content)
    if stated:
        manifest = read(folder / "manifest.json")
        manifest["shards"][shard]["sha256"] = hashlib.sha256(content).hexdigest()
        (folder / "manifest.json").write_text(json.dumps(manifest))


def with_values(folder: Path, shard: int, column: str, to) -> bytes:
    """The bytes of a shard with another column."""
    table = pq.read_table(folder / f"episodes/{shard:05d}.parquet")
    at = table.schema.get_field_index(column)
    field = table.schema.field(column)
    return shard_bytes(
        table.set_column(at, field, pa.array(to(table[column].to_pylist()), field.type))
    )


def larger(values: list) -> list:
    return [values[0] + 1, *values[1:]]


def test_a_value_and_the_digest_beside_it(sweep):
    put_shard(
        sweep, 1, with_values(sweep, 1, "tip_rms_error", lambda x: [1e-9] * len(x)), stated=False
    )
    assert main(["report", str(sweep), "--metric", "effort"]) == 2
    (sweep / "episodes/00001.parquet").unlink()
    command = ["sweep", str(sweep / "spec.toml"), "--out", str(sweep), "--workers", "1"]
    assert main([*command, "--resume"]) == 0
    put_shard(sweep, 1, with_values(sweep, 1, "digest", larger), stated=False)
    assert main(["report", str(sweep), "--metric", "effort"]) == 2
    put_shard(sweep, 1, (sweep / "episodes/00001.parquet").read_bytes(), stated=True)
    assert main(["report", str(sweep), "--metric", "effort"]) == 0  # nothing inside can tell
    assert not verified(sweep, "--episode", "4")  # but a re-run


@pytest.mark.parametrize("column", ["episode", "controller", "seed", "mismatch", "noise"])
def test_rows_of_other_episodes_are_not_those_of_the_plan(sweep, column):
    def to(values: list) -> list:
        return ["fuzzy"] * 4 if column == "controller" else larger(values)

    put_shard(sweep, 1, with_values(sweep, 1, column, to), stated=True)
    with pytest.raises(OctarmError, match="does not hold the episodes that are planned"):
        octarm.read_sweep(sweep, ["effort_tau1"])
    assert main(["report", str(sweep), "--metric", "effort"]) == 2
    assert not verified(sweep, "--episode", "0")


def test_other_shards_under_a_new_checksum(sweep, another, capsys):
    contents = [(sweep / f"episodes/{i:05d}.parquet").read_bytes() for i in range(4)]
    for content in (contents[0], contents[3], b"", b"PAR1", contents[2] * 2):
        put_shard(sweep, 2, content, stated=True)
        if content != contents[2] * 2:
            with pytest.raises(OctarmError, match=r"00002.parquet"):
                octarm.read_sweep(sweep, ["effort_tau1"])
    put_shard(sweep, 2, (another / "episodes/00002.parquet").read_bytes(), stated=True)
    assert not verified(sweep, "--episode", "10")  # the noise is that of another seed


def test_files_more_in_a_sweep(sweep, capsys):
    (sweep / "report").mkdir()
    assert verified(sweep)
    for name in ("notes.txt", "episodes/00004.parquet", "recorded/x", "recorded/3-worst/y"):
        file = sweep / name
        file.parent.mkdir(exist_ok=True)
        file.touch()
        assert not verified(sweep), name
        assert Path(name).name in capsys.readouterr().out or name.endswith("y")
        file.unlink()
        if file.parent.name == "3-worst":
            file.parent.rmdir()
    assert verified(sweep)


@pytest.mark.parametrize("how", ["a byte amid it", "deleted", "swapped"])
@pytest.mark.parametrize("name", ["run.rrd", "run.npz", "run.json"])
def test_a_recorded_episode(sweep, another, name, how):
    folder = next((sweep / "recorded").iterdir())
    FILES[how](folder / name, another / folder.relative_to(sweep) / name)
    assert not verified(sweep, "--episode", "0")


def test_a_recorded_episode_is_the_one_that_its_name_says(sweep, capsys):
    folder = next((sweep / "recorded").iterdir())
    folder.rename(folder.with_name("12-chosen"))
    assert not verified(sweep, "--episode", "0")
    assert "recorded/12-chosen: controller.name" in capsys.readouterr().out


def test_a_changed_recording_of_an_episode_is_made_again(sweep, capsys):
    folder = next((sweep / "recorded").iterdir())
    flipped(folder / "run.npz", 0.5)
    command = ["sweep", str(sweep / "spec.toml"), "--out", str(sweep), "--workers", "1"]
    assert main([*command, "--resume"]) == 0
    assert verified(sweep, "--episode", "3")


def test_contents_do_not_depend_on_when_rerun_has_written_what_stays(tmp_path):
    for name in ("at once", "one by one"):
        with rrd_file(tmp_path / name) as stream:
            for text in ("first", "second"):
                stream.log("note", rr.TextDocument(text), static=True)
                if name == "one by one":
                    stream.flush()
    first, second = (contents(tmp_path / name) for name in ("at once", "one by one"))
    assert first == second
    assert first["/note TextDocument:text"].to_pylist() == [["second"]]

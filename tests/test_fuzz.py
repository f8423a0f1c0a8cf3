"""Whatever a user types and whatever stands in a file, a command ends with a sentence.

Its exit code is one of 0 to 3, standard error has one line at most, which begins as errors do and
can be printed, there is no warning, and a command that refuses leaves everything as it was. These
are 2 000 examples in continuous integration and 200 elsewhere; OCTARM_FUZZ=N takes 200 N others.
"""

import contextlib
import copy
import io
import json
import os
import shutil
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from controllers import CONTROLLERS, make_controller
from octarm.checks import verify
from octarm.commands import margin, report, run, sweep, tune, validate
from octarm.commands.app import arguments_of, commands, is_operand, spelling
from octarm.commands.cli import main
from octarm.disturbances.spelling import DISTURBANCES
from octarm.errors import OctarmError
from octarm.recordings import viewer
from octarm.references import REFERENCES
from octarm.reports import run_figures
from octarm.sweeps.execute import sweep as run_sweep
from octarm.sweeps.spec_file import read_spec

FACTOR = int(os.environ.get("OCTARM_FUZZ", "10" if os.environ.get("CI") else "1"))
LONGEST = 2500  # characters of a line on standard error

SPEC = """\
seed = 3
episodes = 2
duration = 0.7
control_period = 0.002
batch = 2
record = { episodes = [1, "worst"] }

[grid]
controller = ["pd", "smc"]
mismatch = [0.0, 0.1]
disturbance.noise = [0.0, 0.2]

[random.disturbance]
payload = { low = 0.0, high = 0.2, method = "sobol" }

[disturbance]
noise.time = 0.01

[gains.smc]
lambda = 12.0

[gain_set]
smc = "recommended"
"""
GAINS = 'controller = "pd"\nmodules = 3\n[gains]\nK_p = 5.0\n'
RUN = "run --controller afsmc --disturbance noise:0.1 --disturbance payload:0.1,at=0.01 --out a"

MOST_LINES = 5  # an error, after notes on the gains of each controller


def fuzzed(count):
    """Settings for a share of the 200 examples that are taken by default."""
    return settings(
        max_examples=FACTOR * count,
        derandomize="OCTARM_FUZZ" not in os.environ,
        deadline=None,
        database=None,
        suppress_health_check=[HealthCheck.too_slow, HealthCheck.data_too_large],
    )


def not_run(*_, **__):
    """Stands where a command would begin to work for long."""
    raise OctarmError("everything was understood; nothing is run")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """A place with a run, a sweep, a spec and gains."""
    place = tmp_path_factory.mktemp("made")
    with contextlib.chdir(place), contextlib.redirect_stdout(io.StringIO()):
        Path("spec.toml").write_text(SPEC)
        Path("gains.toml").write_text(GAINS)
        assert main([*RUN.split(), "--duration", "0.02"]) == 0
        with ThreadPoolExecutor(1) as executor:
            run_sweep(read_spec("spec.toml"), make_controller, "sweep", executor=executor)
    return place


@pytest.fixture(scope="module")
def place(made, tmp_path_factory):
    """A copy, in which commands do all but work for long or open windows."""
    copy, perform = tmp_path_factory.mktemp("place") / "copy", verify.perform
    shutil.copytree(made, copy)

    def short(environment, controller, announced, **more):
        if announced["duration"] > 100 * announced["control_period"]:
            not_run()
        return perform(environment, controller, announced, **more)

    with pytest.MonkeyPatch.context() as patch, contextlib.chdir(copy):
        patch.setattr(run, "run_into", not_run)
        patch.setattr(run, "_view", lambda _: None)
        patch.setattr(margin, "_search", not_run)
        patch.setattr(tune, "tune_gains", not_run)
        for name in ("estimate", "run_sweep", "dask_cluster"):
            patch.setattr(sweep, name, not_run)
        for name in ("plant", "ledger", "compare_engines", "study"):
            patch.setattr(validate, name, not_run)
        patch.setattr(report, "pictures", lambda _: [])
        patch.setattr(verify, "perform", short)
        patch.setattr(run_figures.NewFigure, "savefig", lambda *_, **__: None)
        patch.setattr(viewer, "open_viewer", lambda _: None)
        patch.setattr(viewer, "screenshot", lambda *_, **__: None)
        patch.setattr(viewer, "serve", lambda *_: None)
        yield copy


def content():
    """All files here, by name."""
    return {path: path.read_bytes() for path in sorted(Path().rglob("*")) if path.is_file()}


def ends_well(*words):
    """Runs a command here, and looks at how it ends."""
    before = content()
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        code = main(words)
    assert code in (0, 1, 2, 3)
    lines = err.getvalue().splitlines()
    assert 1 <= len(lines) <= MOST_LINES if code == 2 else len(lines) < MOST_LINES
    for line in lines:
        assert line.startswith("octarm: ") and len(line) < LONGEST
    for line in (*lines, *out.getvalue().split("\n")):
        assert line.isprintable()
    if code == 2:
        assert content() == before


def restore(made):
    """Makes this place what it was made as."""
    for path in Path().iterdir():
        if path.is_dir() and not path.is_symlink():
            shutil.rmtree(path)
        else:
            path.unlink()
    shutil.copytree(made, Path(), dirs_exist_ok=True)


# What may stand where a word or a number should.
ODD = [
    "", " ", "-", "--", "x" * 5000, "a b " * 1500, "\x1b[31mred\x1b[0m", "a\nb\r\tc", "\u202eevil",
    "\x7f", "\x85", "\u2028", "\udcff", "$x_{", "<script>", "'\"", "{}", "%s", "../..", "/dev/full",
    "é", "日本", "\U0001f600", "nan", "-inf", "1e999", "0x10", "1_0", "9" * 401, "9" * 5000, "None",
]  # fmt: skip
ODD_WORDS = st.sampled_from(ODD) | st.text(max_size=8)
NUMBERS = st.sampled_from(
    ["0", "1", "-1", "0.5", "3", "1e-3", "1e-300", "1e300", "-1e300", "5e-324", "inf", "nan", "2.5"]
)
COUNTS = st.sampled_from(["0", "1", "2", "5", "-1", "40", "1000000000000", "9" * 401])
FILES = st.sampled_from(
    ["a", "sweep", "spec.toml", "gains.toml", "a/run.json", "a/run.rrd", "a/run.npz", "nowhere",
     "new/new", "new.toml", "new.png", "new.mp4", "new.rrd", ".", "..", "sweep/spec.toml",
     "sweep/episodes", "/dev/full", "/dev/null/x", "/proc/x", "a" * 300, "\x1b.toml", "é.rrd"]
)  # fmt: skip
DISTURBANCE = st.builds(
    lambda name, value, more: f"{name}:{value}{more}",
    st.sampled_from([*DISTURBANCES, "nois", ""]),
    NUMBERS | ODD_WORDS,
    st.sampled_from(["", ",at=1", ",at=nan", ",on=theta1+s9", ",time=-1", ",", ",=", ",x=1", "/2"]),
)
NAMED = st.builds(
    lambda name, value: f"{name}:{value}",
    st.sampled_from(["mass", "width", "damping", "lambda", "K", "phi", "tip_rms_error", "", "q"]),
    NUMBERS | ODD_WORDS | st.sampled_from(["1,2", "1,2,3", "1,2;3,4", "0.3,0.2,0.1", ";", ","]),
)
VALUES = {
    "CONTROLLER": st.sampled_from([*CONTROLLERS]),
    "REFERENCE": st.sampled_from([*REFERENCES]),
    "DISTURBANCE": DISTURBANCE,
    "ACTUATION": st.sampled_from(["f-coeff", "internal"]),
    "ARM": st.sampled_from(["octarm", "eth", "fabric"]) | FILES,
    "GAINS": st.sampled_from(["tuned", "recommended"]) | FILES,
    "N": COUNTS,
    "METRIC": st.sampled_from(["rms_error", "effort", "rms_error_theta1"]),
}
NAMED_KINDS = ("NAME:VALUES", "NAME:FACTOR", "METRIC:VALUE")
SLOW = ("doctor",)


@st.composite
def command_lines(draw):
    """A command with options that it has, mostly, and values that suit them, often."""
    command = draw(st.sampled_from([name for name in commands() if name not in SLOW]))
    arguments = arguments_of(command)
    words = [command]
    for argument in arguments:
        kind = str(argument.parameter.metavar or "")
        if kind in ("S", "X", "HZ"):
            usual = NUMBERS
        elif kind in NAMED_KINDS:
            usual = NAMED
        else:
            usual = VALUES.get(kind, FILES)
        value = draw(st.one_of(usual, usual, usual, ODD_WORDS | NUMBERS)) if kind else ""
        if is_operand(argument):
            words += [value] * draw(st.sampled_from([1, 1, 1, 0, 2]))
        elif draw(st.integers(0, 3)) == 0:
            name = spelling(argument)
            words += [[name, value], [f"{name}={value}"], [name]][
                draw(st.sampled_from([0, 0, 0, 1, 2])) if kind else 2
            ]
    if draw(st.integers(0, 9)) == 0:
        words.insert(draw(st.integers(0, len(words))), draw(ODD_WORDS))
    return words


@fuzzed(60)
@given(words=command_lines())
def test_command_lines(made, place, words):
    restore(made)
    ends_well(*words)


# What may stand in a file in place of another value.
HOSTILE = st.sampled_from(
    [None, True, False, 0, -1, 1, 2, 7, 2.5, -0.0, 1e300, -1e300, 5e-324, 1e-3, 10**20, 10**400,
     *ODD, "pd", "noise-2", "noise-0", "inf", [], [1], [None], [[1.0, 2.0], [3.0]], [[]], {},
     {"x": {}}, {"name": "x"}, [{"name": "noise", "asked": {}}], ["a", 1], [0.1] * 7, [[0.1] * 3]]
)  # fmt: skip


def places(value, path=()):
    """The path of every value within a value, itself aside."""
    pairs = (
        value.items() if isinstance(value, dict)
        else enumerate(value) if isinstance(value, list) else ()
    )  # fmt: skip
    for key, item in pairs:
        yield (*path, key)
        yield from places(item, (*path, key))


def changed(draw, text):
    """A JSON text in which some values are others, missing, doubled, or deep."""
    table = json.loads(text)
    for _ in range(draw(st.integers(1, 3))):
        paths = [*places(table)]
        *above, key = paths[draw(st.integers(0, len(paths) - 1))]
        owner = table
        for part in above:
            owner = owner[part]
        how = draw(st.sampled_from(["other", "other", "other", "gone", "new", "deep"]))
        if how == "gone":
            del owner[key]
        elif how == "deep":
            for _ in range(draw(st.sampled_from([1, 3, 100]))):
                owner[key] = [owner[key]]
        elif how == "new" and isinstance(owner, dict):
            owner[draw(ODD_WORDS)] = copy.deepcopy(draw(HOSTILE))
        elif how == "new":
            owner.insert(key, copy.deepcopy(draw(HOSTILE)))
        else:
            owner[key] = copy.deepcopy(draw(HOSTILE))  # which may be changed in turn
    return json.dumps(table)


def damaged(draw, content):
    """Bytes of which some are others, missing or new."""
    content = bytearray(content)
    for _ in range(draw(st.integers(1, 4))):
        at = draw(st.integers(0, len(content)))
        how = draw(st.sampled_from(["flip", "cut", "insert", "remove"]))
        if how == "cut":
            del content[at:]
        elif how == "remove":
            del content[at : at + draw(st.integers(1, 50))]
        elif how == "insert":
            content[at:at] = draw(st.binary(min_size=1, max_size=8))
        elif at < len(content):
            content[at] ^= draw(st.integers(1, 255))
    return bytes(content)


def change_file(draw, file):
    """Damages a file, or if it is JSON, mostly changes its values."""
    if file.suffix == ".json" and draw(st.integers(0, 4)):
        file.write_text(changed(draw, file.read_text()), errors="surrogatepass")
    else:
        file.write_bytes(damaged(draw, file.read_bytes()))


RUN_COMMANDS = ["verify a", "record a", "plot a", "replay a", "replay a a", "video a", "plot sweep"]


@fuzzed(50)
@given(data=st.data())
def test_descriptions_of_runs(made, place, data):
    restore(made)
    change_file(data.draw, Path("a/run.json"))
    ends_well(*data.draw(st.sampled_from(RUN_COMMANDS)).split())


ARRAYS = {
    "object": lambda x: np.full(x.shape, None),
    "words": lambda x: np.full(x.shape, "word"),
    "complex": lambda x: x + 1j,
    "single": lambda x: x.astype("f4"),
    "big-endian": lambda x: x.astype(">f8"),
    "whole": lambda x: x.astype(int),
    "number": lambda x: np.float64(1.0),
    "flat": lambda x: x.ravel(),
    "empty": lambda x: x[:0],
    "short": lambda x: x[:-1],
    "wide": lambda x: np.concatenate([x, x], axis=-1),
    "deep": lambda x: x[..., None, None],
    "nan": lambda x: np.full(x.shape, np.nan),
    "inf": lambda x: np.full(x.shape, -np.inf),
    "huge": lambda x: np.full(x.shape, 1e308),
    "tiny": lambda x: np.full(x.shape, 5e-324),
    "backwards": lambda x: x[::-1],
    "fortran": lambda x: np.asfortranarray(x),
    "structure": lambda x: np.zeros(x.shape, [("a", "f8")]),
    "date": lambda x: x.astype("M8[s]"),
}


def change_arrays(draw, file):
    """Makes arrays of a run other ones, or takes them away, doubles or renames them."""
    arrays = [*np.load(file).items()]
    for _ in range(draw(st.integers(1, 2))):
        at = draw(st.integers(0, len(arrays) - 1))
        name, array = arrays[at]
        how = draw(st.sampled_from(["other"] * 6 + ["gone", "twice", "renamed", "new"]))
        if how == "other" and array.dtype.kind == "f" and array.ndim:
            with np.errstate(all="ignore"):
                arrays[at] = name, ARRAYS[draw(st.sampled_from([*ARRAYS]))](array)
        elif how == "other":
            arrays[at] = name, np.asarray(draw(st.sampled_from([1.0, "x", "x" * 5000, "\x1b", ""])))
        elif how == "gone" and len(arrays) > 1:
            del arrays[at]
        elif how == "twice":
            arrays.append((name, array))
        elif how == "renamed":
            arrays[at] = (
                draw(st.sampled_from(["s", "x", "a/b", "é", "\x1b", "9", "t", "x" * 300])),
                array,
            )
        else:
            arrays.append((draw(st.sampled_from(["s", "V", "E", "theta", "new"])), array))
    kind = draw(st.sampled_from([zipfile.ZIP_STORED] * 3 + [zipfile.ZIP_DEFLATED]))
    with zipfile.ZipFile(file, "w", kind) as archive:
        for name, array in arrays:
            with archive.open(f"{name}.npy", "w") as member:
                np.lib.format.write_array(member, np.asanyarray(array))


@fuzzed(25)
@given(data=st.data())
@pytest.mark.filterwarnings("ignore:Duplicate name:UserWarning")
def test_arrays_of_runs(made, place, data):
    restore(made)
    file = Path("a/run.npz")
    if data.draw(st.booleans()):
        change_arrays(data.draw, file)
    else:
        file.write_bytes(damaged(data.draw, file.read_bytes()))
    ends_well(*data.draw(st.sampled_from(RUN_COMMANDS[:-1])).split())


SWEEP_COMMANDS = [
    "report sweep", "report sweep --metric effort", "verify sweep --episode 3",
    "verify sweep --sample 1", "sweep spec.toml --out sweep --resume", "replay sweep",
]  # fmt: skip


@fuzzed(25)
@given(data=st.data())
def test_folders_of_sweeps(made, place, data):
    restore(made)
    files = ["manifest.json"] * 3 + ["spec.toml", "episodes/00000.parquet"]
    file = Path("sweep", data.draw(st.sampled_from(files)))
    if file.suffix == ".parquet" and data.draw(st.booleans()):
        file.unlink()
    else:
        change_file(data.draw, file)
    ends_well(*data.draw(st.sampled_from(SWEEP_COMMANDS)).split())


KEYS = st.sampled_from(
    ["seed", "duration", "timestep", "control_period", "actuation", "controller", "reference",
     "mismatch", "gain_set", "grid", "random", "disturbance", "gains", "record", "grid.controller",
     "grid.mismatch", "grid.reference", "grid.disturbance", "grid.disturbance.payload",
     "grid.disturbance.noise.on", "random.mismatch", "random.disturbance.pulse.at", "gains.pd.K_p",
     "disturbance.noise-2", "disturbance.noise-1", "disturbance.pulse.on", "gain_set.pd",
     "record.episodes", '"\\u001b"', '"a.b"', "x"]
)  # fmt: skip
TOML = st.sampled_from(
    ["1000000000000", "0", "-1", "2.5", "1e300", "inf", "nan", "1e-9", "true", "''",
     '"pd"', '"smc"', '"sine"',
     '["pd", "smc"]', '["pd", "pd"]', "[]", "[0.0, 1.0]", "[1, 'a']", "[[1.0]]", "{}", "{ x = 1 }",
     "{ low = 0.0, high = 1.0 }", "{ low = 1.0, high = 0.0 }", "{ low = 0, high = inf }",
     "{ low = 0.0, high = 1.0, method = 'x' }", "2026-01-01", "9" * 401, "9" * 5000, "[" * 2000,
     '"gains.toml"', '"x.toml"', '"\\u0000.toml"', '"\\u001b[31m"', '"' + "x" * 5000 + '"',
     '"\\u202e"', '["worst", 0, 99]', "[-1]", '"all"', '"s1+theta9"', "[0.0, -0.0, 0]",
     "[0.1, 0.1]", "[1e400]", "0.7", "0.0005", "1e-5", "0.11", "[0.0, nan]"]
)  # fmt: skip


@fuzzed(40)
@given(data=st.data())
def test_specs(made, place, data):
    restore(made)
    lines: list[str] = [*SPEC.splitlines()]
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(lines)))
        how = data.draw(st.sampled_from(["new", "new", "other", "other", "gone", "damaged"]))
        line = f"{data.draw(KEYS)} = {data.draw(TOML)}"
        if how == "new" or at == len(lines):
            lines.insert(data.draw(st.sampled_from([0, at])), line)
        elif how == "other" and "=" in lines[at]:
            lines[at] = f"{lines[at].partition('=')[0]}= {data.draw(TOML)}"
        elif how == "gone":
            del lines[at]
        elif how == "damaged":
            lines[at] = damaged(data.draw, lines[at].encode()).decode(errors="replace")
    text = "\n".join(lines)
    if data.draw(st.integers(0, 9)):
        Path("spec.toml").write_text(text)
    else:
        Path("spec.toml").write_bytes(damaged(data.draw, text.encode()))
    ends_well("sweep", "spec.toml", "--dry-run")

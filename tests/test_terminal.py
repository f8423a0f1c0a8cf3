"""Whatever the terminal is: a run that is written is a success, and nothing half is left."""

import os
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from forked import Forked, forked

from octarm.errors import ExitCode

pytestmark = pytest.mark.slow  # dozens of processes
ROOT = Path(__file__).parent.parent
RUN = ["run", "--duration", "0.02", "--out", "a"]
WHOLE = {"run.json", "run.npz", "run.rrd"}
COMMANDS = {
    "run": (RUN, "a"),
    "record": (["record", "run", "--out", "b.rrd"], "b.rrd"),
    "plot": (["plot", "run", "--out", "deep/figures"], "deep"),
    "margin": (
        ["margin", "pd", "--disturbance", "payload", "--bound", "effort_tau1:9", "--seeds", "1",
         "--duration", "0.01", "--json", "m.json"], "m.json"),
    "validate": (["validate", "--states", "2", "--json", "v.json"], "v.json"),
    "tune": (["tune", "smc", "--out", "t.toml", "--workers", "1"], "t.toml"),
}  # fmt: skip
SMALL = "from small_tuning import BUDGET, Budget; Budget.within = classmethod(lambda c, s: BUDGET)"


@pytest.fixture(scope="module")
def commands():
    with forked(*(words for words, _ in COMMANDS.values()), code=SMALL) as parent:
        yield parent


@pytest.fixture(scope="module")
def earlier(commands: Forked, tmp_path_factory) -> Path:
    """A folder with a run."""
    folder = tmp_path_factory.mktemp("earlier")
    assert commands.run([*RUN[:-1], "run"], folder) == 0
    return folder / "run"


@pytest.fixture
def place(tmp_path: Path, earlier: Path) -> Path:
    """An empty folder but for a link to a run."""
    (tmp_path / "run").symlink_to(earlier)
    return tmp_path


def made(place: Path) -> set[str]:
    return {path.name for path in place.iterdir()} - {"run", "out", "err"}


@pytest.mark.parametrize(
    ("name", "closed", "full"),
    [
        *(("run", closed, []) for closed in ([0], [1], [2], [1, 2], [0, 1, 2])),
        *(("run", [], full) for full in ([1], [2], [1, 2])),
        *((name, [1], []) for name in COMMANDS if name != "run"),
        *((name, [], [1]) for name in ("record", "margin")),
    ],
)
def test_what_is_written_is_a_success_on_any_terminal(name, closed, full, commands, place):
    words, written = COMMANDS[name]
    assert commands.run(words, place, closed=closed, full=full) == ExitCode.FINE
    assert made(place) == {written}
    texts = [(place / stream).read_text() for stream in ("out", "err")]
    assert "Traceback" not in "".join(texts)
    left = [number for number in (1, 2) if number not in closed + full]
    if left:
        assert len(texts[left[0] - 1].splitlines()) >= 1
        if name not in ("margin", "validate"):
            assert f"wrote {written}" in texts[left[0] - 1]


def test_no_file_takes_the_number_of_a_closed_stream(commands, place):
    assert commands.run(RUN, place, closed=[0, 1, 2]) == 0
    assert commands.run(["verify", "a"], place) == 0
    assert "identical" in (place / "out").read_text()


@pytest.mark.parametrize("full", [[1], [1, 2]])
def test_what_is_only_printed_fails_with_its_output(full, commands, place):
    for words in (["--help"], ["verify", "run"]):
        assert commands.run(words, place, full=full) == ExitCode.BAD_INPUT
        error = (place / "err").read_text()
        assert error == ("" if 2 in full else "octarm: standard output: No space left on device\n")


@pytest.mark.parametrize("stream", [1, 2])
def test_an_error_is_said_on_what_is_left(stream, commands, place):
    for how in ({"closed": [stream]}, {"full": [stream]}):
        assert commands.run(["run", "--seed", "-1"], place, **how) == ExitCode.BAD_INPUT
        text = (place / ("err" if stream == 1 else "out")).read_text()
        assert text == "octarm: seed is -1; it must be at least 0\n"


@pytest.mark.parametrize("name", ["run", "record", "plot"])
def test_too_few_files_leave_nothing(name, commands, place):
    words, written = COMMANDS[name]
    codes = []
    for free in range(16):
        codes.append(commands.run(words, place, free=free))
        error = (place / "err").read_text()
        if codes[-1] == ExitCode.FINE:
            assert made(place) == {written} and error == ""
            break
        assert codes[-1] == ExitCode.BAD_INPUT, error
        assert len(error.splitlines()) == 1 and "oo many" in error
        assert made(place) == set(), f"with {free} files"
    assert codes[-1] == ExitCode.FINE and len(codes) > 4


def test_too_few_files_leave_an_earlier_run_as_it_is(commands, place):
    assert commands.run(RUN, place) == 0
    before, code = (place / "a" / "run.npz").stat().st_ino, -1
    for free in range(16):
        code = commands.run([*RUN, "--force", "--mismatch", "0.1"], place, free=free)
        assert made(place) == {"a"} and {p.name for p in (place / "a").iterdir()} == WHOLE
        assert ((place / "a" / "run.npz").stat().st_ino == before) == (code != 0)
        if code == 0:
            break
    assert code == 0


def octarm(command: str, folder: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """A shell's command, in which `octarm` stands for the program."""
    program = shlex.join([sys.executable, "-m", "octarm"])
    return subprocess.run(
        ["bash", "-c", command.replace("octarm", program, 1)], cwd=folder, text=True,
        capture_output=True, timeout=1800, check=False,
        env={**os.environ, "PYTHONPATH": str(ROOT), **environment},
    )  # fmt: skip


@pytest.mark.parametrize("limit", [9, 16, 40])
def test_a_low_limit_of_open_files_is_one_sentence(limit, tmp_path):
    done = octarm(f"ulimit -n {limit}; octarm run --duration 0.02 --out a", tmp_path)
    assert (done.returncode, done.stdout) == (ExitCode.BAD_INPUT, "")
    assert done.stderr.startswith(f"octarm: the system allows {limit} open files, and octarm needs")
    assert done.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("limit", ["-n 64", "-Sn 9"])
def test_a_limit_that_can_be_raised_or_suffices_is_no_error(limit, tmp_path):
    done = octarm(f"ulimit {limit}; octarm run --duration 0.02 --out a", tmp_path)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    "environment",
    [{"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}],
    ids=["output", "locale"],
)
def test_names_need_not_be_of_the_terminals_letters(environment, tmp_path):
    done = octarm("octarm run --duration 0.02 --out é", tmp_path, **environment)
    assert (done.returncode, done.stderr) == (0, "")
    assert "wrote " in done.stdout
    assert {path.name for path in (tmp_path / "é").iterdir()} == WHOLE
    assert "é" in (tmp_path / "é" / "run.json").read_text().encode().decode("unicode_escape")


def test_names_may_be_of_any_bytes(commands, tmp_path):
    assert commands.run([*RUN[:-1], "a\udcff"], tmp_path) == 0
    assert "wrote a\\udcff/" in (tmp_path / "out").read_text()
    assert commands.run(["plot", "a\udcff"], tmp_path) == 0
    assert rb"a\\xff" in (tmp_path / os.fsdecode(b"a\xff") / "run.json").read_bytes()

"""Whatever is killed and whenever: files are whole or absent, and the next call ends the same.

OCTARM_KILLS=20 kills each as often; the paper's results, which take half a minute, less by default.
"""

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from forked import Forked, forked

import octarm
from octarm.errors import ExitCode

pytestmark = pytest.mark.slow
KILLS = 20
PAPER_KILLS = int(os.environ.get("OCTARM_KILLS", "2"))
SIGNALS = (signal.SIGKILL, signal.SIGINT, signal.SIGTERM, signal.SIGKILL)
SMALL = (
    "import dataclasses, small_tuning as t\n"
    "budget = dataclasses.replace(t.BUDGET, generations=8)\n"
    "t.Budget.within = classmethod(lambda c, s: budget)\n"
)
TUNE = ["tune", "smc", "--seed", "5", "--out", "mine.toml", "--workers", "1"]
MARGIN = [
    "margin", "pd", "smc-boundary", "--disturbance", "payload", "--disturbance", "noise:0.4",
    "--bound", "effort_tau1:12", "--seeds", "3", "--duration", "0.1", "--json", "m.json",
    "--csv", "m.csv", "--force",
]  # fmt: skip
OTHERS = {"notes.txt": "mine", ".mine.toml.part": "mine", "mine.toml.bak": "mine"}


@pytest.fixture(scope="module")
def commands() -> Iterator[Forked]:
    with forked(TUNE, MARGIN, code=SMALL) as parent:
        yield parent


def place(folder: Path, **more: str) -> Path:
    """A folder in which files of others stand."""
    folder.mkdir()
    for name, text in (OTHERS | more).items():
        (folder / name).write_text(text)
    return folder


def contents(folder: Path) -> dict[str, str]:
    """The files of a folder, but for output, parts, and those of others, which are as they were."""
    texts = {path.name: path.read_text() for path in folder.iterdir()}
    assert {name: texts.pop(name) for name in OTHERS} == OTHERS
    return {n: x for n, x in texts.items() if n not in ("out", "err") and ".new.part" not in n}


def struck(commands: Forked, words: list[str], folder: Path, delay: float, number: int) -> int:
    """The exit code of a command that gets a signal after so many seconds."""
    process = commands.start(words, folder)
    time.sleep(delay)
    try:
        os.kill(process, number)
    except ProcessLookupError:
        pass
    code = commands.wait()
    error = (folder / "err").read_text()
    assert "Traceback" not in error
    if number == signal.SIGKILL:
        assert code in (-signal.SIGKILL, ExitCode.FINE)
    else:  # the handlers are there from the first moment
        assert code in (ExitCode.INTERRUPTED, ExitCode.FINE)
        assert (error.startswith("octarm: interrupted") and error.count("\n") == 1) == (code != 0)
    return code


def undisturbed(commands: Forked, words: list[str], folder: Path) -> tuple[dict[str, str], float]:
    """What a command writes, and how long it takes [s]."""
    before = time.monotonic()
    assert commands.run(words, folder) == ExitCode.FINE
    return contents(folder), time.monotonic() - before


def test_tuning_is_killed_at_any_instant(commands, tmp_path):
    expected, span = undisturbed(commands, TUNE, place(tmp_path / "undisturbed"))
    folder, begun, ended = place(tmp_path / "0"), False, 0
    for kill in range(KILLS):
        words = TUNE if kill % 7 else [*TUNE[:-1], "2"]  # worker processes are dear to begin
        words = [*words, "--resume"] if begun else words
        before = contents(folder)
        code = struck(commands, words, folder, span * (kill % 5 + 1) / 8, SIGNALS[kill % 4])
        found = contents(folder)
        assert found.keys() <= {"mine.toml", "mine.toml.state"}
        assert found.get("mine.toml", expected["mine.toml"]) == expected["mine.toml"]
        begun = "mine.toml.state" in found
        if code == ExitCode.INTERRUPTED and begun and found != before:  # the search went on
            assert "go on by: octarm tune smc" in (folder / "err").read_text()
        if code == ExitCode.FINE:
            assert found == expected
            ended += 1
            folder, begun = place(tmp_path / f"{kill + 1}"), False
    assert commands.run([*TUNE, "--resume"] if begun else TUNE, folder) == ExitCode.FINE
    assert contents(folder) == expected
    assert not list(folder.glob("*.new.part"))
    assert ended < KILLS, "none was killed"


def test_a_margin_is_killed_at_any_instant(commands, tmp_path):
    expected, span = undisturbed(commands, MARGIN, place(tmp_path / "undisturbed"))
    earlier = {"m.json": "before", "m.csv": "before"}
    folder, ended = place(tmp_path / "0", **earlier), 0
    for kill in range(KILLS):
        ended += 0 == struck(commands, MARGIN, folder, span * kill / KILLS, SIGNALS[kill % 4])
        for name, text in contents(folder).items():
            assert text in (earlier[name], expected[name])
    assert commands.run(MARGIN, folder) == ExitCode.FINE
    assert contents(folder) == expected
    assert not list(folder.glob("*.new.part"))
    assert ended < KILLS, "none was killed"


def paper(out: Path, *words: str) -> subprocess.Popen[str]:
    """The script, when its imports are over."""
    process = subprocess.Popen(
        [sys.executable, Path(__file__).with_name("small_paper.py"), "--quick", "--out", out,
         *words],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
    )  # fmt: skip
    assert process.stdout is not None and process.stdout.readline() == "begun\n"
    return process


def results(out: Path) -> dict[str, bytes]:
    """Tables, claims and series; timings stand in other files."""
    files = [out / "claims.json", *out.glob("tables/*"), *out.glob("series/*.npz")]
    return {str(file.relative_to(out)): file.read_bytes() for file in files}


def finished(out: Path) -> dict[str, int]:
    """What has been run, and when it was written."""
    files = [*out.glob("series/*.npz"), *out.glob("sweeps/*/episodes/*.parquet")]
    return {str(file): file.stat().st_mtime_ns for file in files}


def test_the_papers_results_are_killed_at_any_instant(tmp_path):
    whole = paper(tmp_path / "undisturbed")
    _, error = whole.communicate(timeout=1800)
    assert (whole.returncode, error) == (0, "")
    expected, steps = results(tmp_path / "undisturbed"), len(finished(tmp_path / "undisturbed"))
    out, killed = tmp_path / "out", 0
    for kill in range(PAPER_KILLS):
        before, wanted = finished(out), steps * (kill + 1) // PAPER_KILLS
        process = paper(out, "--resume")
        while len(finished(out)) < wanted and process.poll() is None:
            time.sleep(0.02)
        time.sleep(0.3 * (kill % 4))
        process.send_signal(SIGNALS[kill % 4])
        _, error = process.communicate(timeout=1800)
        assert "Traceback" not in error
        if SIGNALS[kill % 4] == signal.SIGKILL:
            assert process.returncode in (-signal.SIGKILL, 0)
        else:
            assert process.returncode in (ExitCode.INTERRUPTED, 0), error
            assert ("go on by" in error and "--resume" in error) == (process.returncode != 0)
        killed += process.returncode != 0
        while is_alive(process.pid):  # no worker goes on alone
            time.sleep(0.05)
        after = finished(out)
        assert {name: after[name] for name in before} == before
        found = results(out) if (out / "claims.json").exists() else {}
        assert {name: expected[name] for name in found} == found
    last = paper(out, "--resume")
    _, error = last.communicate(timeout=1800)
    assert (last.returncode, error) == (0, "")
    assert results(out) == expected
    for folder in (out / "sweeps").iterdir():
        table, other = (
            octarm.read_sweep(root / "sweeps" / folder.name).drop_columns(["wall_time"])
            for root in (out, tmp_path / "undisturbed")
        )
        assert table.equals(other)
    assert killed
    assert not list(out.rglob("*.new.part"))
    print(f"{PAPER_KILLS} signals, {killed} runs ended by them")


def is_alive(group: int) -> bool:
    try:
        os.killpg(group, 0)
    except ProcessLookupError:
        return False
    return True

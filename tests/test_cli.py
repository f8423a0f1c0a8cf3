"""The commands as a user meets them."""

import errno
import importlib.metadata
import json
import os
import pty
import re
import shlex
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from recordings import described

import octarm
from octarm.arm.parameters import ArmParameters
from octarm.commands import cli
from octarm.commands.app import commands, parse
from octarm.errors import FileError
from octarm.runs import experiment

ROOT = Path(__file__).resolve().parent.parent
KEYS = {
    "controller", "parameters", "nominal", "reference", "disturbances", "seed", "duration",
    "timestep", "control_period", "metrics", "status", "versions", "digest", "command",
}  # fmt: skip


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def short_run(*options: str) -> int:
    return cli.main(["run", "--duration", "0.05", "--out", "a", *options])


def test_a_run_writes_its_folder_and_says_so(capsys):
    assert short_run("--mismatch", "-0.3") == 0
    out, err = capsys.readouterr()
    assert "smc-boundary on sine" in out and "octarm replay a" in out
    assert err == ""  # no progress bar when piped
    assert sorted(p.name for p in Path("a").iterdir()) == ["run.json", "run.npz", "run.rrd"]
    assert [p.name for p in Path().iterdir()] == ["a"]
    description = json.loads(Path("a/run.json").read_text())
    assert set(description) >= KEYS
    true, nominal = (ArmParameters.from_dict(description[k]) for k in ("parameters", "nominal"))
    np.testing.assert_allclose(nominal.mass, 0.7 * true.mass)
    np.testing.assert_allclose(nominal.stiffness, 0.85 * true.stiffness)
    with np.load("a/run.npz") as arrays:
        names = {"t", "q", "v", "q_d", "v_d", "tau", "force", "disturbance", "s"}
        assert names <= set(arrays)
        assert arrays["q"].shape == (100, 6)


def test_the_metrics_are_those_of_the_arrays():
    assert cli.main(["run", "--duration", "2.1", "--out", "a", "--controller", "smc"]) == 0
    run, description = octarm.read_run("a")
    settled = run.error[run.t >= 2.0]
    rms = np.sqrt(np.mean(settled**2, axis=0))
    np.testing.assert_allclose(description["metrics"]["rms_error"], rms)
    np.testing.assert_allclose(description["metrics"]["peak_error"], np.abs(settled).max(axis=0))
    np.testing.assert_allclose(
        description["metrics"]["effort"], np.sqrt(np.mean(run.tau**2, axis=0))
    )


def test_the_same_command_gives_the_same_bytes_and_another_parameter_does_not():
    assert short_run() == 0
    first = Path("a/run.npz").read_bytes()
    assert short_run("--force") == 0  # replaces the earlier run
    assert Path("a/run.npz").read_bytes() == first
    assert short_run("--force", "--parameter", "damping:12,10,8.001;12,10,8") == 0
    assert Path("a/run.npz").read_bytes() != first


def test_options_reach_the_run():
    options = [
        "--controller", "smc", "--reference", "smooth-step", "--timestep", "0.001",
        "--control-period", "0.002", "--actuation", "internal", "--gain", "lambda:20",
        "--gains", "recommended", "--gain", "K:1,1,1,0.4,0.2,0.1", "--nominal", "mass:0.5",
        "--parameter", "width:0.1",
    ]  # fmt: skip
    assert short_run(*options) == 0
    d = json.loads(Path("a/run.json").read_text())
    assert (d["timestep"], d["control_period"], d["actuation"]) == (0.001, 0.002, "internal")
    assert d["controller"]["name"] == "smc"
    assert d["controller"]["gains"]["lambda_"] == 20.0
    assert d["controller"]["gains"]["K"] == [1, 1, 1, 0.4, 0.2, 0.1]
    assert d["reference"]["name"] == "smooth-step"
    assert d["parameters"]["width"] == d["nominal"]["width"] == [0.1]
    np.testing.assert_allclose(d["nominal"]["mass"], 0.5 * np.array(d["parameters"]["mass"]))


BAD = [
    (["run", "--controller", "smc-boundry"], "unknown controller 'smc-boundry', did you mean"),
    (["run", "--reference", "cosine"], "unknown reference 'cosine'.* known are sine,"),
    (["run", "--actuation", "extern"], "unknown actuation 'extern'.* f-coeff, internal"),
    (["run", "--duration", "-3"], "duration is -3 s; it must be above 0 s"),
    (["run", "--duration", "nan"], "duration is nan s; it must be above 0 s"),
    (["run", "--duration", "long"], "--duration is 'long'; it must be a number"),
    (["run", "--timestep", "aut"], r"--timestep is 'aut'; it must be a number \[s\] or auto"),
    (["run", "--seed", "1.5"], "--seed is '1.5'; it must be a whole number"),
    (["run", "out=a"], "octarm run has no use for 'out=a', did you mean --out=a"),
    (["run", "--controller", "SMC"], "unknown controller 'SMC', did you mean 'smc'"),
    (["run", "--disturbance", "tilt:90"], "it must be at most 3.14159 rad; in degrees .* 90deg"),
    (["replay", "."], ". is not a run folder: it has no run.json; the runs in it are broken, prec"),
    (["run", "--out"], "--out needs a value after it"),
    (["run", "--view=perhaps"], "--view is 'perhaps'; it is a flag and takes no value"),
    (["run", "--timestep", "0"], "timestep is 0 s; it must be between"),
    (["run", "--timestep", "nan"], "timestep is nan s; it must be between"),
    (["run", "--control-period", "0.0007"], "control period is 0.0007 s; .* multiple .* 0.0005 s"),
    (["run", "--control-period", "0"], "control period is 0 s; .* multiple .* 0.0005 s"),
    (["run", "--mismatch", "-1"], "mismatch is -1; .* above -1"),
    (["run", "--gain", "K:nan"], "K holds nan; it must be finite"),
    (["run", "--gain", "K:1,2"], "K has 2 values; it needs 1 or 6"),
    (["run", "--gain", "lambda:-1"], "lambda holds -1; it must be above 0"),
    (["run", "--gain", "Q:1"], "smc-boundary has no gain 'Q'.* known are lambda, K"),
    (["run", "--gain", "K"], "--gain is 'K'; it must read NAME:NUMBER"),
    (["run", "--parameter", "mass:1,2"], r"mass has 2 values; .* each of 3 modules"),
    (["run", "--parameter", "mass:1,1,-1"], "mass holds -1; it must be above 0"),
    (["run", "--parameter", "wdith:1"], "unknown parameter 'wdith', did you mean 'width'"),
    (["run", "--parameter", "stiffness:1,2,3"], r"stiffness has shape \(3,\); it must be"),
    (["run", "--nominal", "mass:-1"], "factor of mass holds -1; it must be above 0"),
    (["run", "--out", "/proc/nothing/run"], "/proc/nothing/run cannot be written: "),
    (["run", "--out", "file.txt"], "file.txt exists and is not an earlier run"),
    (["run", "--out", "full"], "full exists and is not an earlier run"),
    (["run", "--out", "file.txt/run"], "file.txt.*: "),
    (["run", "--out", "precious"], "precious/run.json is there already; --force replaces it"),
    (["run", "--out", "precious", "--force"], "precious exists and is not an earlier run"),
    (["run", "--out", "deep/down/a", "--gain", "K:1;2"], "--gain is 'K:1;2'; a gain is one number"),
    (["run", "--gain", "K:1", "--gain", "K:2"], "--gain gives K twice"),
    (["run", "--duration", "1e300"], "duration is 1e.300 s; it must be at most 500000 s"),
    (["run", "--mismatch", "1e308"], "mismatch is 1e.308; it must be above -1"),
    (["run", "--seed", "-1"], "seed is -1; it must be at least 0"),
    (["run", "--parameter", "mass:1e-20,1,1"], "MuJoCo refuses these parameters"),
    (["run", "--parameter", "gravity:1e10"], "cannot hang in one piece: at rest s1"),
    (["run", "--out", "/dev/null/x"], "/dev/null/x cannot be written"),
    (["replay", "precious"], "precious has no recording run.rrd"),
    (["replay", "broken"], "broken/run.json holds no table"),
    (["validate", "--seed", "-1"], "seed is -1; it must be at least 0"),
    (["validate", "--json", "nowhere/x.json"], "nowhere/x.json cannot be written"),
    (["run", "--duraton", "3"], "octarm run has no option '--duraton', did you mean '--duration'"),
    (["run", "--states", "1"], "octarm run has no option --states; it belongs to octarm validate"),
    (["run", "twice"], "octarm run has no use for 'twice'"),
    (["plot", "a", "b"], "octarm plot has no use for 'b'"),
    (["ran"], "unknown command 'ran', did you mean 'run'.* the nearest of 17 are run, "),
    ([], "no command is given; octarm --help lists them"),
    (["record"], "octarm record needs RUN, run folder"),
    (["completion", "csh"], "unknown shell 'csh'.* known are bash, zsh, fish"),
    (["replay", "nowhere"], "nowhere is not a run folder: it has no run.json"),
    (["replay"], "0 runs are given; replay shows one, or two side by side"),
    (["validate", "--modules", "0"], "modules is 0"),
]


@pytest.mark.parametrize(("arguments", "message"), BAD, ids=[" ".join(a) or "-" for a, _ in BAD])
def test_bad_input_is_one_sentence_and_leaves_nothing(arguments, message, capsys):
    Path("file.txt").write_text("mine")
    Path("full").mkdir()
    Path("full/notes.txt").write_text("mine")
    Path("precious").mkdir()
    Path("precious/run.json").write_text(json.dumps({"format": 3, **described()}))
    Path("precious/notes.txt").write_text("mine")
    Path("broken").mkdir()
    Path("broken/run.json").write_text("[]")
    assert cli.main(arguments) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert len(err.strip().splitlines()) == 1
    assert re.search(message, err), err
    assert {p.name for p in Path().iterdir()} == {"file.txt", "full", "precious", "broken"}
    assert [p.name for p in Path("full").iterdir()] == ["notes.txt"]
    assert {p.name for p in Path("precious").iterdir()} == {"notes.txt", "run.json"}


def test_a_diverging_run_is_kept_and_marked(capsys):
    strong = ["--parameter", "input_range:-inf,inf"]
    assert short_run("--gain", "K:1600,1000,800,400,250,30", *strong) == 3
    out, err = capsys.readouterr()
    assert re.fullmatch(
        r"octarm: the run diverged at t = 0\.00\d+ s: (theta\d moves at .* rad/s, faster than "
        r"50 rad/s|s\d moves at .* m/s, faster than 4\.8 m/s); it was kept up to there\n",
        err,
    )
    assert "replay" not in err and "wrote a/" in out
    run, description = octarm.read_run("a")
    assert run.status == description["status"] == "diverged"
    assert description["message"] == run.message
    assert description["metrics"]["rms_error"] == [None] * 6
    assert len(run) < 20


def test_a_run_says_its_format_and_another_one_is_refused(capsys):
    assert short_run() == 0
    text = Path("a/run.json").read_text()
    description = json.loads(text)
    assert description["format"] == 3
    assert description["coordinates"][0] == {"name": "s1", "unit": "m"}
    assert description["coordinates"][-1] == {"name": "theta3", "unit": "rad"}
    Path("a/run.json").write_text(text.replace('"format": 3', '"format": 4'))
    capsys.readouterr()
    assert cli.main(["verify", "a"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "a/run.json has format 4" in line and "reads format 3" in line


def test_an_interrupt_leaves_nothing_half_written(monkeypatch, capsys):
    def interrupted(*_args, **_options):
        raise KeyboardInterrupt

    monkeypatch.setattr(experiment.ArmRecorder, "run", interrupted)
    assert short_run() == 130
    assert "interrupted" in capsys.readouterr().err
    assert list(Path().iterdir()) == []


def test_an_interrupt_while_replacing_keeps_the_earlier_run(monkeypatch):
    assert short_run() == 0
    before = Path("a/run.npz").read_bytes()
    failing = lambda *_: (_ for _ in ()).throw(FileError("disk full"))  # noqa: E731
    monkeypatch.setattr(experiment.Archive, "save", failing)
    assert short_run("--mismatch", "0.1") == 2
    assert Path("a/run.npz").read_bytes() == before
    assert [p.name for p in Path().iterdir()] == ["a"]


def test_a_time_outside_the_run_and_a_name_that_is_no_picture_are_refused(capsys):
    assert short_run() == 0
    for option, message in (
        (["--time", "3"], "time is 3 s; the run goes from 0 to 0.0495 s"),
        (["--time", "nan"], "time is nan s; the run goes"),
        (["--time", "-1"], "time is -1 s; the run goes"),
    ):
        assert cli.main(["replay", "a", "--screenshot", "x.png", *option]) == 2
        assert message in capsys.readouterr().err
    assert cli.main(["replay", "a", "--screenshot", "x.jpg"]) == 2
    assert "'x.jpg'; its name must end in .png" in capsys.readouterr().err
    assert [p.name for p in Path().iterdir()] == ["a"]


def test_a_link_to_a_run_is_followed():
    assert short_run() == 0
    Path("link").symlink_to("a")
    assert cli.main(["run", "--duration", "0.02", "--out", "link", "--force"]) == 0
    assert Path("link").is_symlink()
    assert len(octarm.read_run("a")[0]) == 40
    assert {p.name for p in Path().iterdir()} == {"a", "link"}


def test_it_runs_as_a_process_elsewhere_and_a_reader_that_goes_away_is_no_error():
    command = f"{sys.executable} -m octarm run --duration 0.01 | true"
    done = subprocess.run(
        ["bash", "-o", "pipefail", "-c", command], capture_output=True, text=True, timeout=1800,
        check=False,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, "")
    folder = next(Path("runs").iterdir())
    assert (folder / "run.json").is_file()
    assert (folder / "run.rrd").stat().st_size > 1000


@pytest.mark.parametrize("name", commands())
def test_the_examples_of_a_page_are_understood(name: str, capsys):
    assert cli.main([name, "--help"]) == 0
    examples = capsys.readouterr().out.partition("\nexamples:\n")[2].partition("\n\n")[0]
    lines = examples.replace("\\\n", " ").splitlines()
    assert lines
    for line in lines:
        words = shlex.split(line.partition(">")[0])
        assert words[:2] == ["octarm", name]
        assert callable(parse(words[1:]))


def test_the_version_is_that_of_the_installed_package(capsys):
    assert cli.main(["--version"]) == 0
    assert capsys.readouterr().out == f"octarm {importlib.metadata.version('octarm')}\n"


def test_errors_are_one_plain_sentence_on_a_terminal_too():
    master, slave = pty.openpty()
    command = [sys.executable, "-m", "octarm", "record"]
    done = subprocess.run(command, stdout=slave, stderr=slave, timeout=1800, check=False)
    text = os.read(master, 4096).decode()
    os.close(master)
    os.close(slave)
    assert done.returncode == 2
    assert text.strip() == "octarm: octarm record needs RUN, run folder"


def interrupted_while_importing(module: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """The console command, to which Ctrl-C comes while it imports a module."""
    code = (
        "import os, signal, sys\n"
        "from octarm.__main__ import command_line\n"
        "class Finder:\n"
        "    def find_spec(self, name, *_):\n"
        f"        if name == {module!r}: os.kill(os.getpid(), signal.SIGINT)\n"
        "sys.meta_path.insert(0, Finder())\n"
        "sys.exit(command_line())\n"
    )
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, capture_output=True, text=True, timeout=1800, check=False)


@pytest.mark.parametrize("module", ["octarm.commands.cli", "cyclopts", "numpy", "mujoco"])
def test_ctrl_c_at_the_very_beginning_is_one_sentence(module: str):
    done = interrupted_while_importing(module, "run", "--duration", "0.01")
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "octarm: interrupted\n")
    assert list(Path().iterdir()) == []


def test_a_package_that_is_missing_is_one_sentence(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "octarm.disturbances.spelling", None)
    assert cli.main(["run"]) == 2
    assert re.search("octarm doctor says what to install", capsys.readouterr().err)


def test_a_bug_shows_its_traceback(monkeypatch):
    def broken(*_args, **_options):
        return np.zeros(2) + np.zeros(3)  # a ValueError of NumPy

    monkeypatch.setattr(experiment.ArmRecorder, "run", broken)
    with pytest.raises(ValueError, match="broadcast"):
        short_run()
    assert list(Path().iterdir()) == []


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (OSError(errno.ENOSPC, "No space left on device", "a/x"), "a/x: No space left on device"),
        (OSError(errno.ENOSPC, "No space left on device"), "standard output: No space left"),
        (MemoryError("3 TiB"), "there is not enough memory: 3 TiB"),
    ],
)
def test_what_the_machine_refuses_is_one_sentence(error, sentence, monkeypatch, capsys):
    def refused(*_args, **_options):
        raise error

    monkeypatch.setattr(experiment.Experiment, "begin", refused)
    assert short_run() == 2
    assert capsys.readouterr().err.startswith(f"octarm: {sentence}")


def test_a_second_interrupt_within_a_moment_changes_nothing():
    code = (
        "import os, signal\n"
        "from octarm.interrupts import held_interrupts, raise_interrupts\n"
        "raise_interrupts()\n"
        "try:\n"
        "    with held_interrupts():\n"
        "        os.kill(os.getpid(), signal.SIGINT); print('held')\n"
        "except KeyboardInterrupt:\n"
        "    os.kill(os.getpid(), signal.SIGTERM); print('closing')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "held\nclosing\n", "")


def test_an_interrupt_while_an_object_is_deleted_is_not_lost():
    code = (
        "import os, signal, time\n"
        "from octarm.interrupts import raise_interrupts\n"
        "raise_interrupts()\n"
        "class Late:\n"
        "    def __del__(self): os.kill(os.getpid(), signal.SIGTERM); time.sleep(0.1)\n"
        "try:\n"
        "    Late(); time.sleep(60); print('lost')\n"
        "except KeyboardInterrupt:\n"
        "    print('came')\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (0, "came\n", "")

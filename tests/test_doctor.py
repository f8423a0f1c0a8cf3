"""What `octarm doctor` finds, on machines that lack something."""

import re
import socket
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import psutil
import pytest
from packaging.specifiers import SpecifierSet

from octarm.checks import doctor as machine
from octarm.checks.doctor import State
from octarm.commands import cli

VERSIONS = [
    ("2.4.6", ">=2", True),
    ("1.26", ">=2", False),
    ("3.17.0", "<4,>=3.17", True),
    ("3.9.1", "<4,>=3.17", False),
    ("4.0.0", "<4,>=3.17", False),
    ("0.41.3", "==0.41.*", True),
    ("0.4", "==0.41.*", False),
    ("3.13.0", "<3.13,>=3.11", False),
    ("3.13.0rc1", "<3.13,>=3.11", False),
    ("3.12.9", "<3.13,>=3.11", True),
]


def answers(*failing: str):
    """Stands for the processes that are tried: those with a word in their command fail."""

    def run(command: list[str], **environment: str) -> subprocess.CompletedProcess[str]:
        words = [*command, *environment.values()]
        for word in failing:
            if word in words:
                return subprocess.CompletedProcess(command, 2, "", f"octarm: no {word} here\n")
        for option in ("--out", "--screenshot"):
            if option in command:
                Path(command[command.index(option) + 1]).touch()
        host = '{"cpu": "a CPU", "machine": "x86_64", "kernels": "X86_V3"}'
        return subprocess.CompletedProcess(command, 0, host, "")

    return run


@pytest.fixture(autouse=True)
def _headless(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(machine.sys, "platform", "linux")
    monkeypatch.chdir(tmp_path)


def doctor(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], *failing: str):
    monkeypatch.setattr(machine, "_run", answers(*failing))
    code = cli.main(["doctor"])
    out, err = capsys.readouterr()
    assert err == ""
    assert max(len(line) for line in out.partition("\nto do:")[0].splitlines()) <= 80
    return code, re.sub(r"\s+", " ", out)


def test_a_good_machine_is_fine(monkeypatch, capsys):
    code, out = doctor(monkeypatch, capsys)
    assert code == 0
    assert "octarm run works here" in out
    assert "ok films by EGL, OSMesa" in out.replace("films films", "films")
    assert "X86_V3 (AVX2)" in out
    assert f"ok numpy {metadata.version('numpy')}" in out


def test_without_runs_it_fails_and_says_why(monkeypatch, capsys):
    code, out = doctor(monkeypatch, capsys, "run")
    assert code == 1
    assert "BROKEN octarm run no run here" in out
    assert "octarm run does not work here" in out


@pytest.mark.parametrize(
    ("failing", "told", "remedy"),
    [
        (["egl", "osmesa"], "no OpenGL library works: no osmesa here", "libosmesa6"),
        (["--screenshot"], "screenshots no --screenshot here", "mesa-vulkan-drivers"),
        ([], "viewer there is no display", "--web"),
    ],
)
def test_what_is_missing_is_told_with_what_to_install(failing, told, remedy, monkeypatch, capsys):
    code, out = doctor(monkeypatch, capsys, *failing)
    assert code == 0
    assert f"missing {told}" in out.replace("films no", "no")
    assert remedy in out.partition("to do:")[2]


def test_an_egl_that_does_not_work_is_stepped_around(monkeypatch, capsys):
    monkeypatch.setattr(machine, "find_library", lambda name: name)
    _, out = doctor(monkeypatch, capsys, "egl")
    assert "films: export MUJOCO_GL=osmesa" in out


def test_a_display_is_asked_whether_it_answers(monkeypatch, capsys, tmp_path):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-9")
    _, out = doctor(monkeypatch, capsys)
    assert "missing viewer the display wayland-9 does not answer" in out
    with socket.socket(socket.AF_UNIX) as display:
        display.bind(str(tmp_path / "wayland-9"))
        display.listen()
        _, out = doctor(monkeypatch, capsys)
    assert "ok viewer a display answers" in out


def test_a_folder_that_cannot_be_written_is_told(monkeypatch):
    monkeypatch.chdir("/proc")
    runs, _ = machine.folders()
    assert runs.state is State.MISSING
    assert runs.text.startswith("/proc cannot be written: ")


@pytest.mark.parametrize(("version", "asked", "good"), VERSIONS)
def test_versions_are_compared_as_numbers(version, asked, good):
    finding = machine.version("x", version, SpecifierSet(asked), "remedy")
    assert finding.state is (State.FINE if good else State.OUTSIDE)


def test_a_package_that_is_missing_is_told(monkeypatch):
    found = metadata.version

    def version(name: str) -> str:
        if name == "matplotlib":
            raise metadata.PackageNotFoundError(name)
        return "1.0" if name == "numpy" else found(name)

    monkeypatch.setattr(metadata, "version", version)
    told = {finding.name: finding for finding in machine.versions()}
    assert told["matplotlib"].state is State.MISSING
    assert told["matplotlib"].remedy.startswith("pip install 'matplotlib>=")
    assert told["numpy"].state is State.OUTSIDE
    assert told["python"].state is State.FINE


def test_a_process_that_crashes_or_hangs_is_a_finding(monkeypatch):
    crash = ["bash", "-c", "kill -SEGV $$"]
    assert machine._last_line(machine._run(crash)) == "it was ended by signal 11"
    monkeypatch.setattr(machine, "_PATIENCE", 0.05)
    done = machine._run(["sleep", "5"])
    assert done.returncode == 1
    assert machine._last_line(done) == "no answer within 0.05 s"


def test_what_works_is_waited_for_however_long_it_takes(monkeypatch):
    monkeypatch.setattr(machine, "_PATIENCE", 1.0)
    busy = "import time\nend = time.process_time() + 1.3\nwhile time.process_time() < end: pass"
    assert machine._run([sys.executable, "-c", busy]).returncode == 0
    monkeypatch.setattr(machine, "_WORK", 0.3)
    assert machine._run([sys.executable, "-c", busy]).returncode == 1


def test_what_was_started_ends_with_what_is_tried(monkeypatch, tmp_path):
    monkeypatch.setattr(machine, "_PATIENCE", 0.2)
    machine._run(["bash", "-c", f"sleep 1800 & echo $! > {tmp_path}/child; wait"])
    child = int((tmp_path / "child").read_text())
    assert not psutil.pid_exists(child) or psutil.Process(child).status() == "zombie"


def test_a_machine_that_is_too_slow_lacks_nothing(monkeypatch, capsys):
    trial = machine.Trial("no answer within 120 s", slow=True)
    for finding in (machine._screenshots(trial), machine._films({"EGL": trial, "OSMesa": trial})):
        assert finding.state is State.SLOW
        assert "install" not in finding.remedy
    gone = subprocess.CompletedProcess([], 1, "", "no answer within 120 s")
    monkeypatch.setattr(machine, "_run", lambda command, **environment: gone)
    assert cli.main(["doctor"]) == 1
    out = capsys.readouterr().out
    assert "octarm run was too slow here to tell whether it works" in out
    assert "apt-get" not in out


def test_a_busy_machine_says_so(monkeypatch):
    monkeypatch.setattr(machine.os, "getloadavg", lambda: (100.0, 0.0, 0.0))
    monkeypatch.setattr(machine, "_run", answers())
    found = {finding.name: finding for finding in machine.processor()}
    assert found["load"].state is State.SLOW
    monkeypatch.setattr(machine.os, "getloadavg", lambda: (0.5, 0.0, 0.0))
    assert "load" not in {finding.name for finding in machine.processor()}

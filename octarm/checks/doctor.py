"""What a machine has for octarm: tried out, each in a process of its own, for it may crash.

This module needs only the standard library and `packaging`, so that it can say what is missing of
the rest.
"""

from __future__ import annotations

import contextlib
import enum
import json
import os
import platform
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from ctypes.util import find_library
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

_PATIENCE = 120.0  # [s] for which what is tried may do nothing
_WORK = 600.0  # [s] of processor time that it may use
_ROOM = 1e9  # [byte]; below, a sweep may fill the disk
_NAMES = {"X86_V4": "X86_V4 (AVX-512)", "X86_V3": "X86_V3 (AVX2)"}  # NumPy's, of instructions
_SLOW = 1  # exit code of `octarm.errors.TooSlow`
_OCTARM = (sys.executable, "-P", "-m", "octarm")  # -P: as the command octarm, from any folder


class State(enum.Enum):
    """Whether something is as it should be; runs work all the same unless something is `BROKEN`.

    A version is outside when octarm does not ask for such a one. What is slow got nowhere on a busy
    machine, and may work on a quiet one.
    """

    FINE = "ok"
    NOTE = "-"
    MISSING = "missing"
    OUTSIDE = "outside"
    SLOW = "slow"
    BROKEN = "BROKEN"


class Finding(NamedTuple):
    """One line of the report: what was looked at, how it is, and what to do, if anything."""

    name: str
    state: State
    text: str
    remedy: str = ""


class Trial(NamedTuple):
    """What came of something that was tried: why it failed, empty if not, or was only too slow."""

    failure: str = ""
    slow: bool = False

    def finding(self, name: str, state: State, remedy: str = "") -> Finding:
        """The failure as a line of the report, whose state and remedy are for a missing part."""
        if not self.slow:
            return Finding(name, state, self.failure, remedy)
        remedy = "octarm doctor again, when the machine is less busy"
        return Finding(name, State.SLOW, f"too slow to tell: {self.failure}", remedy)


# Extras that are told of, and what needs them.
_EXTRAS = {"cluster": "--cluster", "fast": "--engine lagrange", "gym": "octarm.gym"}


def versions() -> Iterator[Finding]:
    """Python, octarm, and what octarm needs, each against what octarm asks for."""
    try:
        octarm = metadata.metadata("octarm")
        requirements = metadata.requires("octarm") or []
    except metadata.PackageNotFoundError:
        yield Finding("octarm", State.BROKEN, "is not installed", "pip install -e . in its folder")
        return
    python = SpecifierSet(octarm["Requires-Python"])
    yield version("python", platform.python_version(), python, "")
    yield Finding("octarm", State.FINE, f"{octarm['Version']}, in {Path(__file__).parents[1]}")
    for requirement in map(Requirement, requirements):
        name, asked, marker = requirement.name, requirement.specifier, requirement.marker
        extra = ""
        if marker is not None and not marker.evaluate({"extra": ""}):
            extra = next((e for e in _EXTRAS if marker.evaluate({"extra": e})), None)
        if extra is None:
            continue  # what tests and other extras need
        remedy = f"pip install 'octarm[{extra}]'" if extra else f"pip install '{name}{asked}'"
        try:
            yield version(name, metadata.version(name), asked, remedy)
        except metadata.PackageNotFoundError:
            text = f"not installed; {asked} is needed" + (f" by {_EXTRAS[extra]}" if extra else "")
            yield Finding(name, State.MISSING, text, remedy)


def version(name: str, installed: str, asked: SpecifierSet, remedy: str) -> Finding:
    """A version against those that are supported."""
    if asked.contains(installed, prereleases=True):
        return Finding(name, State.FINE, installed)
    return Finding(name, State.OUTSIDE, f"{installed}; {asked} is supported", remedy)


def processor() -> Iterator[Finding]:
    """Cores, and the instructions on which last bits depend."""
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    yield Finding("cores", State.NOTE, f"{usable} of {os.cpu_count()}")
    code = "import json; from octarm.runs.versions import host; print(json.dumps(host()))"
    done = _run([sys.executable, "-c", code])
    if done.returncode:
        yield _trial(done).finding("instructions", State.MISSING)
        return
    host = json.loads(done.stdout)
    kernels = host["kernels"]
    yield Finding("processor", State.NOTE, f"{host['cpu']} ({host['machine']})")
    text = (
        f"{_NAMES.get(kernels, kernels or 'unknown')}, for NumPy's sin, cos, exp and tanh; other "
        "ones round some last bits otherwise, so that octarm verify may find other digests there"
    )
    yield Finding("instructions", State.NOTE, text)


def work() -> Iterator[Finding]:
    """What octarm does with this machine: a run, a film of it, a picture of it, a window."""
    try:
        scratch = tempfile.TemporaryDirectory(prefix="octarm-doctor-")
    except OSError as error:
        yield Finding("octarm run", State.BROKEN, f"cannot be tried: {error.strerror}")
        return
    with scratch:
        folder = Path(scratch.name) / "run"
        done = _run([*_OCTARM, "run", "--duration", "0.05", "--out", str(folder)])
        if done.returncode:
            yield _trial(done).finding("octarm run", State.BROKEN)
            return
        yield Finding("octarm run", State.FINE, "ran, and wrote a run folder")
        size = ["--width", "64", "--height", "48", "--rate", "20"]
        video, replay = [*_OCTARM, "video", str(folder)], [*_OCTARM, "replay", str(folder)]
        with ThreadPoolExecutor() as pool:
            films = {
                gl: pool.submit(
                    _tried, folder.with_name(f"{gl}.mp4"), [*video, *size], "--out",
                    MUJOCO_GL=gl.lower(),
                )
                for gl in ("EGL", "OSMesa")
            }  # fmt: skip
            picture = pool.submit(_tried, folder.with_name("p.png"), replay, "--screenshot")
            yield _films({gl: film.result() for gl, film in films.items()})
            yield _screenshots(picture.result())
    yield _window()


def _films(trials: dict[str, Trial]) -> Finding:
    """Which OpenGL libraries film, given what came of each."""
    working = [gl for gl, trial in trials.items() if not trial.failure]
    if not working:
        failure = next((trial for trial in trials.values() if trial.slow), trials["OSMesa"])
        text = f"no OpenGL library works: {failure.failure}"
        remedy = (
            "apt-get install libosmesa6 (Debian, in software), or libegl1 and a graphics driver"
        )
        return Trial(text, failure.slow).finding("films", State.MISSING, remedy)
    if not (working[0] == "EGL" or trials["EGL"].slow) and find_library("EGL"):
        text = "EGL is there but does not work; OSMesa does"
        return Finding("films", State.MISSING, text, "export MUJOCO_GL=osmesa")
    return Finding("films", State.FINE, "films by " + ", ".join(working))


def _screenshots(trial: Trial) -> Finding:
    if not trial.failure:
        return Finding("screenshots", State.FINE, "pictures by Vulkan")
    remedy = "apt-get install mesa-vulkan-drivers (Debian, in software)"
    return trial.finding("screenshots", State.MISSING, remedy)


def _window() -> Finding:
    """Whether there is a display."""
    tried = os.environ.get("WAYLAND_DISPLAY") or os.environ.get("DISPLAY")
    if tried or sys.platform != "linux":
        return Finding("viewer", State.NOTE, f"opens a window on {tried or 'this desktop'}")
    remedy = "octarm replay RUN --web, or --screenshot FILE.png, which need none"
    return Finding("viewer", State.MISSING, "there is no display", remedy)


def folders() -> Iterator[Finding]:
    """Whether the folders can be written that octarm writes, and the room in them."""
    runs = Path("runs") if Path("runs").is_dir() else Path()
    yield _folder("runs", runs, "work in another folder, or give --out DIR")
    temporary = Path(os.environ.get("TMPDIR") or "/tmp")
    yield _folder("temporary files", temporary, "export TMPDIR=FOLDER")


def _folder(name: str, folder: Path, remedy: str) -> Finding:
    try:
        with tempfile.TemporaryFile(dir=folder) as file:
            file.write(b"octarm")
            file.flush()
        free = shutil.disk_usage(folder).free
    except OSError as error:
        text = f"{folder.resolve()} cannot be written: {error.strerror}"
        return Finding(name, State.MISSING, text, remedy)
    text = f"{folder.resolve()} can be written, {free / 1e9:.1f} GB free"
    return Finding(name, State.FINE if free > _ROOM else State.MISSING, text)


def _run(command: list[str], **environment: str) -> subprocess.CompletedProcess[str]:
    """Runs a command for as long as it works; exit code 1 if it gets nowhere.

    What counts is the processor time that its processes use, not how long a busy machine takes.
    """
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as errors:
        process = subprocess.Popen(
            command, stdout=out, stderr=errors, stdin=subprocess.DEVNULL,
            env={**os.environ, **environment}, start_new_session=True,
        )  # fmt: skip
        try:
            if not _ends(process):
                text = f"no answer within {_PATIENCE:g} s"
                return subprocess.CompletedProcess(command, _SLOW, "", text)
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)  # with what it has started
            process.wait()
        texts: list[str] = []
        for file in (out, errors):
            file.seek(0)
            texts.append(file.read())
        return subprocess.CompletedProcess(command, process.returncode, *texts)


def _ends(process: subprocess.Popen[bytes]) -> bool:
    """Waits for a process that leads its group; False if it gets nowhere."""
    used, since = -1.0, time.monotonic()
    while process.poll() is None:
        if (now := _processor_time(process.pid)) != used:
            used, since = now, time.monotonic()
        if time.monotonic() - since > _PATIENCE or used > _WORK:
            return False
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(min(0.2, _PATIENCE))
    return True


def _processor_time(group: int) -> float:
    """What the processes of a group have used so far [s]; 0 where the system does not say."""
    ticks = 0
    for file in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # one that has just ended
            fields = file.read_text(errors="replace").rpartition(")")[2].split()
            if int(fields[2]) == group:
                ticks += int(fields[11]) + int(fields[12])
    return ticks / os.sysconf("SC_CLK_TCK")


def _tried(file: Path, command: list[str], option: str, **environment: str) -> Trial:
    """What keeps a command from writing a file, given after an option."""
    done = _run([*command, option, str(file)], **environment)
    return Trial() if done.returncode == 0 and file.is_file() else _trial(done)


def _trial(done: subprocess.CompletedProcess[str]) -> Trial:
    """The last thing that a command said, or the signal that ended it."""
    if done.returncode < 0:
        return Trial(f"it was ended by signal {-done.returncode}")
    lines = done.stderr.strip().splitlines() or [f"exit code {done.returncode}"]
    said = lines[-1].removeprefix("octarm: ").partition("; octarm doctor")[0]
    return Trial(said, done.returncode == _SLOW)

"""What a machine has for octarm: tried out, each in a process of its own, for it may crash.

This module needs only the standard library and `packaging`, so that it can say what is missing of
the rest.
"""

from __future__ import annotations

import enum
import json
import os
import platform
import re
import shutil
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from ctypes.util import find_library
from importlib import metadata
from pathlib import Path
from typing import NamedTuple

from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet

_PATIENCE = 120.0  # [s]
_ROOM = 1e9  # [byte]; below, a sweep may fill the disk
_NAMES = {"X86_V4": "X86_V4 (AVX-512)", "X86_V3": "X86_V3 (AVX2)"}  # NumPy's, of instructions
_OCTARM = (sys.executable, "-m", "octarm")


class State(enum.Enum):
    """Whether something is as it should be; runs work all the same unless something is `BROKEN`.

    A version is outside when octarm does not ask for such a one.
    """

    FINE = "ok"
    NOTE = "-"
    MISSING = "missing"
    OUTSIDE = "outside"
    BROKEN = "BROKEN"


class Finding(NamedTuple):
    """One line of the report.

    Attributes:
        name: what was looked at.
        state: how it is.
        text: what was found.
        remedy: what to do about it; empty when there is nothing to do.
    """

    name: str
    state: State
    text: str
    remedy: str = ""


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
        yield Finding("instructions", State.MISSING, _last_line(done))
        return
    host = json.loads(done.stdout)
    kernels = host["kernels"]
    yield Finding("processor", State.NOTE, f"{host['cpu']} ({host['machine']})")
    text = (
        f"{_NAMES.get(kernels, kernels or 'unknown')}, for NumPy's sin, cos, exp and tanh. With "
        "others, AVX2 instead of AVX-512 for one, they round some last bits otherwise: on such a "
        "machine octarm verify may find other digests for the same run"
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
            yield Finding("octarm run", State.BROKEN, _last_line(done))
            return
        yield Finding("octarm run", State.FINE, "ran, and wrote a run folder")
        size = ["--width", "64", "--height", "48", "--rate", "20"]
        video, replay = [*_OCTARM, "video", str(folder)], [*_OCTARM, "replay", str(folder)]
        with ThreadPoolExecutor() as pool:
            films = {
                gl: pool.submit(
                    _failure, folder.with_name(f"{gl}.mp4"), [*video, *size], "--out",
                    MUJOCO_GL=gl.lower(),
                )
                for gl in ("EGL", "OSMesa")
            }  # fmt: skip
            picture = pool.submit(_failure, folder.with_name("p.png"), replay, "--screenshot")
            yield _films({gl: film.result() for gl, film in films.items()})
            yield _screenshots(picture.result())
    yield _window()


def _films(failures: dict[str, str]) -> Finding:
    """Which OpenGL libraries film, given what went wrong with each; empty when nothing did."""
    working = [gl for gl, failure in failures.items() if not failure]
    if not working:
        text = f"no OpenGL library works: {failures['OSMesa']}"
        remedy = (
            "apt-get install libosmesa6 (Debian, in software), or libegl1 and a graphics driver"
        )
        return Finding("films", State.MISSING, text, remedy)
    if sys.platform == "linux" and "EGL" not in working and find_library("EGL"):
        text = "EGL is there but does not work; OSMesa does"
        return Finding("films", State.MISSING, text, "export MUJOCO_GL=osmesa")
    return Finding("films", State.FINE, "films by " + ", ".join(working))


def _screenshots(failure: str) -> Finding:
    if not failure:
        return Finding("screenshots", State.FINE, "pictures by Vulkan")
    remedy = "apt-get install mesa-vulkan-drivers (Debian, in software)"
    return Finding("screenshots", State.MISSING, failure, remedy)


def _window() -> Finding:
    """Whether a display answers, without opening a window on it."""
    name = "viewer"
    if sys.platform != "linux":
        return Finding(name, State.NOTE, "opens a window of this desktop")
    wayland, x11 = (os.environ.get(key, "") for key in ("WAYLAND_DISPLAY", "DISPLAY"))
    addresses: list[str | tuple[str, int]] = []
    if wayland:
        addresses.append(os.path.join(os.environ.get("XDG_RUNTIME_DIR", ""), wayland))
    if match := re.fullmatch(r"([^:]*):(\d+)(\.\d+)?", x11):
        local = match[1] in ("", "unix")
        addresses.append(
            f"/tmp/.X11-unix/X{match[2]}" if local else (match[1], 6000 + int(match[2]))
        )
    if any(map(_answers, addresses)):
        return Finding(name, State.FINE, "a display answers")
    tried = wayland or x11
    text = f"the display {tried} does not answer" if tried else "there is no display"
    remedy = "octarm replay RUN --web, or --screenshot FILE.png, which need none"
    return Finding(name, State.MISSING, text, remedy)


def _answers(address: str | tuple[str, int]) -> bool:
    family = socket.AF_UNIX if isinstance(address, str) else socket.AF_INET
    with socket.socket(family) as probe:
        probe.settimeout(2.0)
        try:
            probe.connect(address)
        except OSError:
            return False
    return True


def folders() -> Iterator[Finding]:
    """Whether the folders can be written that octarm writes, and the room in them."""
    runs = Path("runs") if Path("runs").is_dir() else Path()
    yield _folder("runs", runs, "work in another folder, or give --out DIR")
    candidates = [os.environ.get(name, "") for name in ("TMPDIR", "TEMP", "TMP")]
    temporary = next((Path(c) for c in [*candidates, "/tmp"] if c and Path(c).is_dir()), Path())
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
    """Runs a command; one that takes too long has failed."""
    try:
        return subprocess.run(
            command, capture_output=True, text=True, timeout=_PATIENCE, check=False,
            stdin=subprocess.DEVNULL, env={**os.environ, **environment},
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(command, 1, "", f"no answer within {_PATIENCE:g} s")


def _failure(file: Path, command: list[str], option: str, **environment: str) -> str:
    """What keeps a command from writing a file, given after an option; empty if nothing does."""
    done = _run([*command, option, str(file)], **environment)
    return "" if done.returncode == 0 and file.is_file() else _last_line(done)


def _last_line(done: subprocess.CompletedProcess[str]) -> str:
    """The last thing that a command said, or the signal that ended it."""
    lines = done.stderr.strip().splitlines()
    if done.returncode < 0:
        return f"it was ended by signal {-done.returncode}"
    said = lines[-1].removeprefix("octarm: ") if lines else f"exit code {done.returncode}"
    return said.partition("; octarm doctor")[0]

"""The rerun viewer that ships with the package, as a process of its own.

It serves on 127.0.0.1 only, and proxies that lead nowhere keep it from asking the network for news
or sending usage data.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import socket
import subprocess
import sys
import tempfile
import time as clock
import urllib.parse
from collections.abc import Callable, Generator, Iterable
from pathlib import Path
from typing import IO, TYPE_CHECKING

from octarm.files import whole_file
from octarm.recordings.web_page import guarded_page

if TYPE_CHECKING:
    from octarm.recordings.recording import ViewerClient

_NOWHERE = "http://127.0.0.1:9"


def open_viewer(paths: Iterable[str | os.PathLike[str]]) -> None:
    """Shows recordings in a window, and returns when it is closed.

    Args:
        paths: `.rrd` files.

    Raises:
        FileNotFoundError: if a file does not exist.
        RuntimeError: if there is no display, or the viewer fails.
    """
    files = [_existing(path) for path in paths]
    displays = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")
    if sys.platform == "linux" and not any(os.environ.get(name) for name in displays):
        raise RuntimeError(
            "there is no display to open the viewer on; --screenshot FILE.png makes a picture "
            "without one"
        )
    with _viewer(files) as (process, _, errors):
        if process.wait() != 0:
            raise RuntimeError(_reason(errors))


def serve(paths: Iterable[str | os.PathLike[str]], ready: Callable[[str], object]) -> None:
    """Serves recordings to a browser on this machine, and returns when it is interrupted.

    All that the page needs comes from the installed package, and a browser is told to fetch from
    this machine only.

    Args:
        paths: `.rrd` files.
        ready: called with the address to open.

    Raises:
        FileNotFoundError: if a file does not exist.
        RuntimeError: if the server fails.
    """
    files = [_existing(path) for path in paths]
    port = _free_port()
    web = ["--serve-web", "--web-viewer-port", str(port)]
    with _viewer([*web, *files]) as (process, url, errors):
        _await_page(process, port, errors)
        query = urllib.parse.urlencode({"url": url})
        data_port = urllib.parse.urlsplit(url.removeprefix("rerun+")).port or 0
        with guarded_page(port, data_port) as page, contextlib.suppress(KeyboardInterrupt):
            ready(f"http://127.0.0.1:{page}/?{query}")
            process.wait()
            raise RuntimeError(_reason(errors))


def rescue(partial: str | os.PathLike[str], path: str | os.PathLike[str]) -> None:
    """Writes what can be read of a recording that was not finished as one that is.

    Its plots show what time there is rather than the time that was planned.

    Raises:
        RuntimeError: if nothing can be read.
    """
    from octarm.recordings.recording import time_axes  # imports rerun, which takes half a second

    with tempfile.TemporaryDirectory(prefix="octarm-") as scratch:
        whole = os.path.join(scratch, "whole.rrd")
        _rrd(partial, "merge", "--continue-on-error", str(partial), "-o", whole)
        dropped = [item for axis in time_axes(whole) for item in ("--drop-entity", axis)]
        _rrd(partial, "filter", *dropped, whole, "-o", str(path))
    end_of(path)


def listed(recording: str | os.PathLike[str], path: str | os.PathLike[str]) -> None:
    """Writes a recording as one of several, for which the viewer keeps its list of them open.

    Raises:
        RuntimeError: if it cannot be read.
    """
    arguments = ("--drop-entity", "/blueprint_panel", str(recording), "-o", str(path))
    _rrd(recording, "filter", *arguments)


def _rrd(recording: str | os.PathLike[str], *arguments: str) -> None:
    """A command of rerun on a recording."""
    command = [str(_executable()), "rrd", *arguments]
    done = subprocess.run(command, capture_output=True, env=_environment(), check=False)
    if done.returncode:
        raise RuntimeError(f"nothing can be read of {recording}")


def end_of(path: str | os.PathLike[str]) -> float:
    """The last instant of a recording [s].

    Raises:
        RuntimeError: if the file is not a recording, or has no instants.
    """
    from octarm.recordings.recording import last_instant  # imports rerun, which takes half a second

    return last_instant(_existing(path))


def screenshot(
    recording: str | os.PathLike[str],
    png: str | os.PathLike[str],
    *,
    others: Iterable[str | os.PathLike[str]] = (),
    time: float | None = None,
    size: tuple[int, int] = (1600, 900),
    timeout: float = 60.0,
) -> None:
    """Draws what the viewer shows of a recording into a PNG, whole or not at all.

    It needs no display and no GPU, but some Vulkan driver.

    Args:
        recording: an `.rrd` file.
        png: the picture; its folder must exist.
        others: further recordings that are open; see `listed`.
        time: instant to show [s]; the first one if None.
        size: width and height [pixel].
        timeout: how long to wait for the viewer [s].

    Raises:
        OSError: if the recording does not exist, or the picture cannot be written.
        RuntimeError: if there is no Vulkan driver, or the viewer fails.
    """
    files = [_existing(path) for path in (*others, recording)]
    window = ["--headless", "--window-size", f"{size[0]}x{size[1]}"]
    with whole_file(png) as part, _viewer([*window, *files]) as (process, url, errors):
        try:
            picture = _capture(process, url, time, timeout)
        except (OSError, RuntimeError) as error:
            clock.sleep(0.2)  # a viewer that is ending may not be gone yet
            why = f"{recording} cannot be drawn: {error}"
            raise RuntimeError(why if process.poll() is None else _reason(errors)) from error
        part.write_bytes(picture)


def _capture(
    process: subprocess.Popen[bytes], url: str, time: float | None, timeout: float
) -> bytes:
    """A picture of what the viewer shows once it has come to rest, as PNG."""
    deadline = clock.monotonic() + timeout
    client, image = None, b""
    while process.poll() is None and clock.monotonic() < deadline:
        clock.sleep(0.1)
        client = client or _connect(url, time)
        before, image = image, client.take_screenshot() if client else b""
        if image and image == before:  # plots glide to their ranges at first
            return image
    raise RuntimeError(f"the rerun viewer showed nothing steady within {timeout:g} s")


def _await_page(process: subprocess.Popen[bytes], port: int, errors: IO[bytes]) -> None:
    """Waits until the page is served."""
    deadline = clock.monotonic() + 30.0
    while clock.monotonic() < deadline:
        if process.poll() is not None:
            raise RuntimeError(_reason(errors))
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
            return
        clock.sleep(0.05)
    raise RuntimeError("the rerun viewer did not serve its page within 30 s")


def _connect(url: str, time: float | None) -> ViewerClient | None:
    """A client once the recording is loaded, at the time asked for."""
    from octarm.recordings.recording import ViewerClient  # imports rerun, which takes half a second

    try:
        client = ViewerClient(url)
        state = client.get_state()
    except (ConnectionError, RuntimeError):  # not up yet
        return None
    errors = [entry.message for entry in client.get_logs() if entry.level == "ERROR"]
    if errors:
        raise RuntimeError(f"the rerun viewer says: {errors[0].splitlines()[0]}")
    if state.loading or not any(recording.timelines for recording in state.recordings):
        return None
    blueprint = client.get_blueprint(of="recording").blueprint
    blueprint["/top_panel"] = {"PanelBlueprint": {"state": "Hidden"}}
    client.set_blueprint(blueprint, of="recording")
    if time is not None:
        client.set_time("t", duration=time, play_state="paused")
    return client


@contextlib.contextmanager
def _viewer(arguments: list[str]) -> Generator[tuple[subprocess.Popen[bytes], str, IO[bytes]]]:
    """A running viewer, the address it serves at, and its standard error; ended on leaving."""
    port = _free_port()
    command = [str(_executable()), "--bind", "127.0.0.1", "--port", str(port)]
    command += ["--hide-welcome-screen", *arguments]
    url = f"rerun+http://127.0.0.1:{port}/proxy"
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=errors, stderr=errors, env=_environment()
        )
        try:
            yield process, url, errors
        finally:
            process.kill()  # it has nothing to save; does nothing to one that has ended
            process.wait()


def _environment() -> dict[str, str]:
    kept = {k: v for k, v in os.environ.items() if not k.lower().endswith("_proxy")}
    proxies = dict.fromkeys(("ALL_PROXY", "HTTP_PROXY", "HTTPS_PROXY"), _NOWHERE)
    local = {"NO_PROXY": "127.0.0.1,localhost"}
    # Lesser messages would pop up over the plots; RERUN_APP_ONLY spares the welcome text.
    return {**kept, **proxies, **local, "RUST_LOG": "error", "RERUN_APP_ONLY": "true"}


def _executable() -> Path:
    """The viewer itself: the `rerun` command is a script that would leave it behind when killed."""
    spec = importlib.util.find_spec("rerun_cli")
    folder = Path(spec.origin).parent if spec and spec.origin else Path()
    names = ("Rerun.app/Contents/MacOS/Rerun", "rerun", "rerun.exe")
    for name in names if spec else ():
        if (folder / name).is_file():
            return folder / name
    raise RuntimeError("the rerun viewer is missing; reinstall rerun-sdk")


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def _existing(path: str | os.PathLike[str]) -> str:
    if not os.path.isfile(path):
        raise FileNotFoundError(f"there is no recording {os.fspath(path)}")
    return os.path.abspath(path)


def _reason(errors: IO[bytes]) -> str:
    """One sentence on why the viewer ended."""
    errors.seek(0)
    text = errors.read().decode(errors="replace")
    if "render context" in text or "graphics adapter" in text:
        return (
            "drawing without a display needs a Vulkan driver, software Vulkan at least: on Debian "
            "it is the package mesa-vulkan-drivers"
        )
    lines = [line for line in text.splitlines() if "panicked" in line or "rror" in line]
    return f"the rerun viewer failed: {lines[-1].strip() if lines else 'it gave no reason'}"

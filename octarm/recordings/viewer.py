"""The rerun viewer that ships with the package, in a separate process.

It serves on 127.0.0.1 only, and proxies that lead nowhere keep it from asking the network for news
or sending usage data. Its page asks for fonts and news elsewhere, so the page is passed on with a
policy by which a browser fetches from this machine only. Nothing waits for the viewer longer than
it works: see `_Viewer.pause`.
"""

from __future__ import annotations

import contextlib
import http.client
import http.server
import importlib.util
import os
import re
import socket
import subprocess
import sys
import tempfile
import threading
import time as clock
import urllib.parse
from collections.abc import Callable, Generator, Iterable
from pathlib import Path
from typing import IO, TYPE_CHECKING

import psutil

from octarm.errors import FileError, OctarmError, TooSlow
from octarm.files import whole_file

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient

PATIENCE = 60.0  # [s] for which the viewer may do nothing
_PASSED_ON = ("Content-Type", "Content-Encoding", "Cache-Control", "ETag")
_DISPLAYS = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")
_TARGET = re.compile(r"/[!-~]*")  # of a request: a path in characters that HTTP allows
Name = str | os.PathLike[str]


def open_viewer(paths: Iterable[Name]) -> None:
    """Shows `.rrd` files in a window, and returns when it is closed.

    Raises OctarmError if a file does not exist, there is no display, or the viewer fails.
    """
    files = [_existing(path) for path in paths]
    check_display("--screenshot FILE.png makes a picture without one")
    with _running(files) as viewer:
        if viewer.process.wait() != 0:
            raise viewer.failure()


def check_display(otherwise: str) -> None:
    """Raises OctarmError if there is no display for a window; it says what to do otherwise."""
    if sys.platform == "linux" and not any(os.environ.get(name) for name in _DISPLAYS):
        raise OctarmError(f"there is no display to open the viewer on; {otherwise}")


@contextlib.contextmanager
def open_for_run(address: str = "") -> Generator[str]:
    """The URL of a viewer that shows a run while it goes on, at HOST:PORT.

    Without an address a window is opened, which is waited for in the end. Raises OctarmError if
    there is no display, or nothing listens at the address.
    """
    if address:
        host, _, port = address.rpartition(":")
        try:
            socket.create_connection((host, int(port)), 5.0).close()
        except OSError as error:
            reason = error.strerror or error
            raise OctarmError(f"no viewer listens at {address}: {reason}") from None
        yield f"rerun+http://{address}/proxy"
        return
    check_display("--live HOST:PORT takes a viewer elsewhere")
    with _running([]) as viewer:
        _await(viewer, viewer.port)
        yield viewer.url
        viewer.process.wait()


def _await(viewer: _Viewer, port: int) -> None:
    while True:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
            return
        viewer.pause(PATIENCE)


def serve(paths: Iterable[Name], ready: Callable[[str], object]) -> None:
    """Serves `.rrd` files to a browser on this machine, and returns when it is interrupted.

    All that the page needs comes from the installed package, and a browser may fetch from this
    machine only. `ready` is called with the address to open. Raises OctarmError if a file does not
    exist, or the server fails.
    """
    files, port = [_existing(path) for path in paths], _free_port()
    with _running(["--serve-web", "--web-viewer-port", str(port), *files]) as viewer:
        _await(viewer, port)
        query = urllib.parse.urlencode({"url": viewer.url, "theme": "dark"})
        with _guarded_page(port, viewer.port) as page, contextlib.suppress(KeyboardInterrupt):
            ready(f"http://127.0.0.1:{page}/?{query}")
            viewer.process.wait()
            raise viewer.failure()


def screenshot(
    recording: Name,
    png: Name,
    *,
    others: Iterable[Name] = (),
    time: float | None = None,
    size: tuple[int, int] = (1600, 900),
    timeout: float | None = None,
) -> None:
    """Draws what the viewer shows of a recording into a PNG, whole or not at all.

    It needs no display and no GPU, but some Vulkan driver. Other recordings may be open as well. It
    is of one instant [s], the first one if None, and of this width and height [pixel]. The viewer
    may do nothing for the timeout [s], `PATIENCE` if None, see `_Viewer.pause`.

    Raises OctarmError if the recording is missing, or cannot be drawn on this machine, TooSlow if
    the viewer gets nowhere, OSError if the picture cannot be written.
    """
    files = [_existing(path) for path in (*others, recording)]
    window = ["--headless", "--window-size", f"{size[0]}x{size[1]}"]
    timeout = PATIENCE if timeout is None else timeout
    with whole_file(png) as part, _running([*window, *files]) as viewer:
        try:
            while (client := viewer.client(time)) is None:
                viewer.pause(timeout)
            before, picture = b"", viewer.picture(client)
            while not picture or picture != before:  # plots glide to their ranges at first
                viewer.pause(timeout)
                before, picture = picture, viewer.picture(client)
        except TooSlow:
            raise
        except (OctarmError, OSError, RuntimeError) as error:
            with contextlib.suppress(subprocess.TimeoutExpired):
                viewer.process.wait(1.0)  # a viewer that is ending may not be gone yet
                raise viewer.failure() from error
            raise OctarmError(f"{recording} cannot be drawn: {error}") from error
        part.write_bytes(picture)


class _Viewer:
    """A running viewer, and the port and the address that it serves recordings at."""

    def __init__(self, process: subprocess.Popen[bytes], port: int, errors: IO[bytes]) -> None:
        self.process, self.port, self._errors = process, port, errors
        self.url = f"rerun+http://127.0.0.1:{port}/proxy"
        self._worked, self._since, self._late = -1.0, clock.monotonic(), ""

    def pause(self, patience: float) -> None:
        """Waits a moment for the viewer to get on, if it has not ended and patience [s] lasts.

        It may do nothing, by its processor time, for so long, and work in vain for twice as long.
        """
        clock.sleep(0.1)
        if self.process.poll() is not None:
            raise self.failure()
        with contextlib.suppress(psutil.Error):  # it is just ending
            used = psutil.Process(self.process.pid).cpu_times()
            if used.user + used.system > self._worked:
                self._worked, self._since = used.user + used.system, clock.monotonic()
        if clock.monotonic() - self._since > patience or self._worked > 2.0 * patience:
            raise TooSlow(
                f"the rerun viewer got nowhere within {patience:g} s{self._late}; on a machine "
                "that is less busy it may"
            )

    def failure(self) -> OctarmError:
        """One sentence on why the viewer ended."""
        self._errors.seek(0)
        text = self._errors.read().decode(errors="replace")
        if "render context" in text or "graphics adapter" in text:
            return OctarmError(
                "drawing without a display needs a Vulkan driver, software Vulkan at least: on "
                "Debian it is the package mesa-vulkan-drivers"
            )
        lines = [line for line in text.splitlines() if "panicked" in line or "rror" in line]
        reason = lines[-1].strip() if lines else "it gave no reason"
        return OctarmError(f"the rerun viewer failed: {reason}")

    def picture(self, client: ViewerClient) -> bytes:
        """What the viewer shows, as PNG; empty if it does not answer in the time that it has."""
        try:
            return client.take_screenshot()
        except (ConnectionError, RuntimeError, TimeoutError) as error:
            self._late = f" ({' '.join(str(error).split())})"
            return b""

    def client(self, time: float | None) -> ViewerClient | None:
        """A client once the recording is loaded, at the time asked for."""
        from rerun.experimental import ViewerClient  # the import takes half a second

        try:
            client = ViewerClient(self.url)
            state = client.get_state()
            errors = [entry.message for entry in client.get_logs() if entry.level == "ERROR"]
            if errors:
                raise OctarmError(f"the rerun viewer says: {errors[0].splitlines()[0]}")
            timelines = [recording.timelines for recording in state.recordings]
            if state.loading or not timelines or not all(timelines):
                return None
            blueprint = client.get_blueprint(of="recording").blueprint
            blueprint["/top_panel"] = {"PanelBlueprint": {"state": "Hidden"}}
            client.set_blueprint(blueprint, of="recording")
            if time is not None:
                client.set_time("t", duration=time, play_state="paused")
            return client
        except (ConnectionError, RuntimeError, TimeoutError):  # not up yet, or busy
            return None


@contextlib.contextmanager
def _running(arguments: list[str]) -> Generator[_Viewer]:
    """A running viewer, ended on leaving."""
    port = _free_port()
    command = [str(_executable()), "--bind", "127.0.0.1", "--port", str(port)]
    command += ["--hide-welcome-screen", *arguments]
    with tempfile.TemporaryFile() as errors:
        process = subprocess.Popen(
            command, stdin=subprocess.DEVNULL, stdout=errors, stderr=errors, env=_environment()
        )
        try:
            yield _Viewer(process, port, errors)
        finally:
            process.kill()  # it has nothing to save; does nothing to one that has ended
            process.wait()


def _environment() -> dict[str, str]:
    """The environment of the viewer, without a way to the network."""
    kept = {k: v for k, v in os.environ.items() if not k.lower().endswith("_proxy")}
    proxies = dict.fromkeys(("ALL_PROXY", "HTTP_PROXY", "HTTPS_PROXY"), "http://127.0.0.1:9")
    local = {"NO_PROXY": "127.0.0.1,localhost"}
    # Lesser messages would pop up over the plots; RERUN_APP_ONLY spares the welcome text.
    return {**kept, **proxies, **local, "RUST_LOG": "error", "RERUN_APP_ONLY": "true"}


def _executable() -> Path:
    """The viewer itself: the `rerun` command is a script that would leave it behind when killed."""
    spec = importlib.util.find_spec("rerun_cli")
    folder = Path(spec.origin).parent if spec and spec.origin else Path()
    if not (folder / "rerun").is_file():
        raise OctarmError("the rerun viewer is missing; reinstall rerun-sdk")
    return folder / "rerun"


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


@contextlib.contextmanager
def _guarded_page(page_port: int, data_port: int) -> Generator[int]:
    """Passes on the page that rerun serves at `page_port`; yields the port to open.

    A request under another host name comes from a site that lets its name stand for 127.0.0.1, and
    would read what is recorded. The page may load from `data_port` alone, besides.
    """
    page = "'self' 'unsafe-inline' 'unsafe-eval' blob: data:"
    data = f"http://127.0.0.1:{data_port} ws://127.0.0.1:{data_port}"
    policy = f"default-src {page}; connect-src 'self' blob: data: {data}"

    class Handler(http.server.BaseHTTPRequestHandler):
        protocol_version = default_request_version = "HTTP/1.1"  # also of what is no request

        def handle(self) -> None:
            with contextlib.suppress(ConnectionError):  # the browser has gone away
                super().handle()

        def do_GET(self) -> None:
            hosts = self.headers.get_all("Host", [])
            if not _TARGET.fullmatch(self.path) or len(hosts) != 1:
                self.send_error(http.HTTPStatus.BAD_REQUEST)
                return
            if hosts[0].lower() not in (f"127.0.0.1:{port}", f"localhost:{port}"):
                self.send_error(http.HTTPStatus.FORBIDDEN)  # another site leads the browser here
                return
            encodings = self.headers.get("Accept-Encoding", "identity")
            source = http.client.HTTPConnection("127.0.0.1", page_port)
            try:
                with contextlib.closing(source):
                    source.request("GET", self.path, headers={"Accept-Encoding": encodings})
                    answer = source.getresponse()
                    body = answer.read()
            except (http.client.HTTPException, OSError, ValueError):
                self.send_error(http.HTTPStatus.BAD_GATEWAY)
                return
            self.send_response(answer.status)
            for name in _PASSED_ON:
                if (value := answer.getheader(name)) is not None:
                    self.send_header(name, value)
            self.send_header("Content-Length", str(len(body)))
            self.send_header("Content-Security-Policy", policy)
            self.end_headers()
            self.wfile.write(body)

        def log_message(self, format: str, *args: object) -> None:
            del format, args

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        port = server.server_address[1]
        threading.Thread(target=server.serve_forever, daemon=True).start()
        try:
            yield port
        finally:
            server.shutdown()


def _existing(path: Name) -> str:
    if not os.path.isfile(path):
        raise FileError(f"there is no recording {os.fspath(path)}")
    return os.path.abspath(path)

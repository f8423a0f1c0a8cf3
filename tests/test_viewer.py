"""Pictures and windows of the rerun viewer, and how it ends."""

import dataclasses
import os
import signal
import subprocess
import sys
import urllib.parse
import urllib.request

import numpy as np
import psutil
import pytest
from PIL import Image
from recordings import described, swinging

from octarm.arm.mjcf import nominal_parameters
from octarm.commands import cli
from octarm.errors import OctarmError, TooSlow
from octarm.palette import BRIGHT_MODULES
from octarm.recordings import viewer
from octarm.recordings.comparison import write_comparison
from octarm.recordings.recording import write_recording
from octarm.recordings.viewer import open_viewer, screenshot
from octarm.simulation.trajectory import Trajectory

linux = pytest.mark.skipif(sys.platform != "linux", reason="Vulkan and displays as on Linux")
posix = pytest.mark.skipif(os.name != "posix", reason="the stand-in for the viewer is a script")


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    t = np.arange(400) / 200.0
    bend = np.sin(np.pi * t[:, None]) * [0.35, 0.25, 0.15]
    q = np.concatenate([0.12 + 0.03 * bend, bend], axis=1)
    zero = np.zeros_like(q)
    run = Trajectory(
        t=t, q=q, v=zero, q_d=1.1 * q, v_d=zero, tau=q, force=q, disturbance=zero, signals={}
    )
    path = tmp_path_factory.mktemp("run") / "run.rrd"
    write_recording(path, run, {"parameters": nominal_parameters().to_dict()})
    return path


@pytest.fixture(scope="module")
def picture(recording):
    """A screenshot; whoever has no Vulkan skips, continuous integration excepted."""
    png = recording.with_name("picture.png")
    try:
        screenshot(recording, png, time=0.5, size=(960, 600))
    except OctarmError as error:
        if "Vulkan" not in str(error) or os.environ.get("CI"):
            raise
        pytest.skip(str(error))
    return png


@pytest.fixture
def stand_in(tmp_path, monkeypatch):
    """Replaces the viewer by a shell script; returns a function that sets its text."""
    script = tmp_path / "viewer.sh"

    def write(text):
        script.write_text(f"#!/bin/sh\n{text}\n")
        script.chmod(0o755)

    monkeypatch.setattr(viewer, "_executable", lambda: script)
    monkeypatch.setenv("DISPLAY", ":0")
    return write


@pytest.fixture
def started(monkeypatch):
    """The processes that were started."""
    processes = []
    start = subprocess.Popen

    def popen(*args, **kwargs):
        processes.append(start(*args, **kwargs))
        return processes[-1]

    monkeypatch.setattr(subprocess, "Popen", popen)
    return processes


@pytest.mark.slow
def test_a_picture_has_the_size_asked_for_and_shows_something(picture):
    with Image.open(picture) as image:
        assert image.size == (960, 600)
        colors = image.convert("RGB").getcolors(maxcolors=1 << 24) or []
    assert len(colors) > 500
    common = {color for count, color in colors if count > 300}
    assert {tuple(bytes.fromhex(color[1:])) for color in BRIGHT_MODULES[:3]} <= common


@pytest.mark.slow
def test_another_time_is_another_picture(picture, recording, tmp_path):
    screenshot(recording, tmp_path / "later.png", time=1.5, size=(960, 600))
    first, later = (np.asarray(Image.open(p)) for p in (picture, tmp_path / "later.png"))
    assert np.mean(first[:, :380] != later[:, :380]) > 0.02  # the arm, on the left


@pytest.mark.slow
def test_the_viewer_serves_this_machine_only_and_is_gone_afterwards(
    picture, recording, started, tmp_path
):
    arguments = ["--headless", "--window-size", "320x200", str(recording)]
    with viewer._running(arguments) as shown:
        served = []
        while not served:
            shown.pause(20.0)
            sockets = psutil.Process(shown.process.pid).net_connections(kind="inet")
            served = [s.laddr.ip for s in sockets if s.status == psutil.CONN_LISTEN]
    assert set(served) == {"127.0.0.1"}
    assert [p.poll() is not None for p in started] == [True]


@pytest.mark.slow
def test_a_damaged_recording_is_one_sentence(picture, tmp_path, started):
    (tmp_path / "bad.rrd").write_bytes(b"no recording")
    with pytest.raises(OctarmError, match=r"bad\.rrd cannot be drawn"):
        screenshot(tmp_path / "bad.rrd", tmp_path / "bad.png")
    assert [p.name for p in tmp_path.iterdir()] == ["bad.rrd"]
    assert started[0].poll() is not None


@pytest.mark.slow
@linux
def test_missing_vulkan_is_one_sentence_and_leaves_nothing(
    recording, tmp_path, monkeypatch, started
):
    monkeypatch.setenv("VK_DRIVER_FILES", str(tmp_path / "none.json"))
    monkeypatch.setenv("VK_ICD_FILENAMES", str(tmp_path / "none.json"))
    with pytest.raises(OctarmError, match="mesa-vulkan-drivers"):
        screenshot(recording, tmp_path / "picture.png")
    assert list(tmp_path.iterdir()) == []
    assert started[0].poll() is not None


@posix
def test_a_viewer_that_hangs_is_ended(recording, tmp_path, stand_in, started):
    stand_in("exec sleep 1800")
    with pytest.raises(TooSlow, match=r"within 0\.5 s; on a machine that is less busy it may$"):
        screenshot(recording, tmp_path / "picture.png", timeout=0.5)
    assert started[0].poll() is not None
    assert not list(tmp_path.glob("picture*"))


class Late:
    """A client of a viewer that does not answer in time at first."""

    def __init__(self, *answers):
        self._answers = list(answers)

    def take_screenshot(self):
        answer = self._answers.pop(0)
        if isinstance(answer, Exception):
            raise answer
        return answer


@posix
def test_a_viewer_that_answers_late_is_waited_for(recording, tmp_path, stand_in, monkeypatch):
    stand_in("while true; do :; done")
    late = RuntimeError("timed out after 30 s")
    answers = iter([None, Late(late, b"", b"first", late, b"same", b"same")])
    monkeypatch.setattr(viewer._Viewer, "client", lambda self, time: next(answers))
    screenshot(recording, tmp_path / "picture.png")
    assert (tmp_path / "picture.png").read_bytes() == b"same"


@posix
def test_what_got_nowhere_is_no_bad_input(recording, tmp_path, stand_in, monkeypatch, capsys):
    stand_in("exec sleep 1800")
    late = [RuntimeError("timed out")] * 1000
    monkeypatch.setattr(viewer._Viewer, "client", lambda self, time: Late(*late))
    monkeypatch.setattr(viewer, "PATIENCE", 0.5)
    words = ["replay", str(recording), "--screenshot", str(tmp_path / "picture.png")]
    assert cli.main(words) == 1
    assert "got nowhere within 0.5 s (timed out)" in capsys.readouterr().err


def test_an_unwritable_picture_fails_before_the_work(recording, tmp_path, started):
    with pytest.raises(OSError, match=r"a\.png cannot be written: No such file or directory$"):
        screenshot(recording, tmp_path / "folder" / "a.png")
    assert started == []


def test_a_missing_recording_is_one_sentence(tmp_path):
    for show in (lambda path: open_viewer([path]), lambda path: screenshot(path, "a.png")):
        with pytest.raises(OctarmError, match=r"there is no recording .*run\.rrd$"):
            show(tmp_path / "run.rrd")


@linux
def test_without_a_display_a_screenshot_is_suggested(recording, monkeypatch, started):
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(OctarmError, match="--screenshot"):
        open_viewer([recording])
    assert started == []


@posix
def test_the_window_opens_all_files_on_this_machine_only(recording, tmp_path, stand_in):
    stand_in(f'echo "$@" > {tmp_path}/called; env > {tmp_path}/environment')
    open_viewer([recording, recording])
    called = (tmp_path / "called").read_text().split()
    assert called[:2] == ["--bind", "127.0.0.1"]
    assert called[-2:] == [str(recording)] * 2
    assert "HTTPS_PROXY=http://127.0.0.1:9" in (tmp_path / "environment").read_text().split()


@posix
def test_a_viewer_that_fails_is_one_sentence(recording, stand_in):
    stand_in("echo 'Error: no luck' >&2; exit 3")
    with pytest.raises(OctarmError, match="the rerun viewer failed: Error: no luck"):
        open_viewer([recording])


def kinds():
    """Runs of each kind, and how many views they need at least."""
    run = swinging(rows=600)
    rules = np.random.default_rng(0).normal(size=(600, 6, 5))
    pushed = [{"name": "payload", "asked": {"mass": 0.2, "at": 0.1}, "delivered": {}}]
    yield "plain", dataclasses.replace(run, signals={}), {}, 7
    yield "sliding", run, {}, 12
    adaptive = swinging(rows=600, E=np.abs(run.force), theta=rules, alpha=rules)
    yield "adaptive", adaptive, {}, 15
    yield "disturbed", dataclasses.replace(run, disturbance=run.force), {"disturbances": pushed}, 15


KINDS = list(kinds())


@pytest.mark.slow
@pytest.mark.parametrize(("name", "run", "more", "views"), KINDS, ids=[kind[0] for kind in KINDS])
def test_every_kind_of_run_opens_without_warnings(picture, tmp_path, name, run, more, views):
    path = tmp_path / f"{name}.rrd"
    write_recording(path, run, described(**more))
    assert shown_views(path) >= views


@pytest.mark.slow
def test_a_comparison_opens_without_warnings(picture, tmp_path):
    path = tmp_path / "both.rrd"
    run = (swinging(rows=600), described())
    write_comparison(path, run, run)
    assert shown_views(path) >= 10


def shown_views(path):
    """How many views the viewer shows of a recording, none of which complains."""
    arguments = ["--headless", "--window-size", "960x600", str(path)]
    with viewer._running(arguments) as shown:
        while (client := shown.client(0.3)) is None:
            shown.pause(30.0)
        for _ in range(3):
            client.take_screenshot()
        state, logs = client.get_state(), client.get_logs()
    assert [(view.name, view.reports) for view in state.views if view.reports] == []
    assert [entry.message for entry in logs if entry.level in ("WARN", "ERROR")] == []
    return len(state.views)


@pytest.mark.slow
@posix
def test_the_page_is_served_on_this_machine_and_may_fetch_from_it_only(picture, recording):
    process = subprocess.Popen(
        [sys.executable, "-m", "octarm", "replay", str(recording), "--web"],
        stdout=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        assert process.stdout is not None
        address = process.stdout.readline().split()[1]
        with urllib.request.urlopen(address) as page:
            assert b"rerun" in page.read()
            allowed = page.headers["Content-Security-Policy"]
        with urllib.request.urlopen(urllib.parse.urljoin(address, "re_viewer_bg.wasm")) as wasm:
            assert wasm.read()[:4] == b"\0asm"
        places = [word for word in allowed.split() if "//" in word]
        assert {urllib.parse.urlsplit(place).hostname for place in places} == {"127.0.0.1"}
        children = psutil.Process(process.pid).children(recursive=True)
        found = [c for p in (psutil.Process(process.pid), *children) for c in p.net_connections()]
        assert {c.laddr.ip for c in found if c.status == psutil.CONN_LISTEN} == {"127.0.0.1"}
    finally:
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=1800)
    assert process.returncode == 0
    assert all(not child.is_running() for child in children)

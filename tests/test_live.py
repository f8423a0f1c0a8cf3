"""A run in a viewer while it goes on, and the arm in dm_control's viewer."""

import contextlib
import itertools
import os
import re
import subprocess
import sys
import time
from collections.abc import Generator
from pathlib import Path

import numpy as np
import pytest
from dm_control import viewer as windows
from recordings import described, swinging

import octarm
from controllers import make_controller
from octarm.commands import run as run_command
from octarm.commands.cli import main
from octarm.disturbances.spelling import parse_disturbance
from octarm.errors import OctarmError
from octarm.recordings import viewer
from octarm.recordings.rrd import contents
from octarm.recordings.viewing import LiveRecording
from octarm.simulation.policy import Policy

RUN = ["run", "--controller", "afsmc", "--disturbance", "noise:.4", "--duration", "1.2"]


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)


@contextlib.contextmanager
def sink(path: Path) -> Generator[tuple[str, subprocess.Popen[bytes]]]:
    """A server of rerun on this machine that writes what it is sent; its address."""
    port = viewer._free_port()
    command = [str(viewer._executable()), "--bind", "127.0.0.1", "--port", str(port)]
    environment = viewer._environment()
    with subprocess.Popen([*command, "--save", str(path)], env=environment, stderr=-3) as process:
        running = viewer._Viewer(process, port, open(os.devnull, "rb"))
        viewer._await(running, port)
        try:
            yield f"127.0.0.1:{port}", process
        finally:
            process.kill()


def compared(path: Path) -> dict[str, str]:
    """What a recording holds, but for the command line and when its picture of rules was drawn."""
    values = {key: repr(x.to_pylist()) for key, x in contents(path).items()}  # NaN included
    without = {k: x for k, x in values.items() if "command" not in k and "heat/now" not in k}
    return {key: re.sub(r"```.*?```", "", x) for key, x in without.items()}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # the sink that is killed writes no footer
def test_the_viewer_gets_the_run_and_the_recording_is_the_same():
    assert main([*RUN, "--out", "alone"]) == 0
    with sink(Path("got.rrd")) as (address, process):
        assert main([*RUN, "--out", "live", "--live", address]) == 0
        expected, got = compared(Path("live/run.rrd")), {}
        deadline = time.monotonic() + 120.0
        while got != expected and time.monotonic() < deadline:
            assert process.poll() is None
            time.sleep(0.2)
            with contextlib.suppress(OctarmError):  # half of a message
                got = compared(Path("got.rrd"))
        assert got == expected
    assert compared(Path("alone/run.rrd")) == expected
    assert Path("alone/run.npz").read_bytes() == Path("live/run.npz").read_bytes()


def test_the_viewer_is_sent_rows_as_they_come(monkeypatch: pytest.MonkeyPatch):
    blocks, ended = [], []

    class Viewer:
        """Notes what it is sent."""

        def __init__(self, url: str, description: dict, say: object) -> None:
            assert url == "rerun+http://127.0.0.1:5/proxy"
            assert description["status"] == "running"

        def add(self, rows: dict, layer: np.ndarray) -> None:
            blocks.append(rows["q"].copy())

        def finish(self, description: dict) -> None:
            ended.append(description["status"])

    @contextlib.contextmanager
    def opened(address: str) -> Generator[str]:
        yield f"rerun+http://{address}/proxy"
        assert ended

    monkeypatch.setattr(run_command, "LiveRecording", Viewer)
    monkeypatch.setattr(viewer, "open_for_run", opened)
    assert main([*RUN, "--out", "a", "--live", "127.0.0.1:5"]) == 0
    assert ended == ["ok"]
    assert [len(block) for block in blocks] == [500, 500, 500, 500, 400]
    np.testing.assert_array_equal(np.concatenate(blocks), octarm.read_run("a").trajectory.q)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")  # the sink that is killed writes no footer
def test_a_viewer_that_goes_away_does_not_end_the_run(capfd: pytest.CaptureFixture[str]):
    run, said = swinging(rows=3000), []
    rows = dict(run.arrays())
    with sink(Path("got.rrd")) as (address, process):
        live = LiveRecording(f"rerun+http://{address}/proxy", described(), said.append)
        live.add({name: x[:1000] for name, x in rows.items()}, run.layer)
        assert not said
        process.kill()
        process.wait()
        for first, last in itertools.pairwise((1000, 2000, 3000)):
            live.add({name: x[first:last] for name, x in rows.items()}, run.layer)
        live.finish(described())
    assert said == ["the viewer has gone away; the run goes on without it"]


def test_live_without_a_viewer_is_refused_before_the_run(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    for name in viewer._DISPLAYS:
        monkeypatch.delenv(name, raising=False)
    port = viewer._free_port()
    for words, sentence in (
        (["run", "--live"], "there is no display to open the viewer on; --live HOST:PORT takes"),
        (["run", "--live", f"127.0.0.1:{port}"], f"no viewer listens at 127.0.0.1:{port}: "),
        (["run", "--live", "here"], "--live is 'here'; an address reads HOST:PORT"),
        (["run", "--live", "here:99999"], "--live is 'here:99999'; an address reads HOST:PORT"),
        (["run", "--live", "a:1", "b:2"], "--live takes one value at most"),
        (["run", "--live", "a:1", "--live", "b:2"], "--live is given with --view, or twice"),
        (["run", "--live", "--view"], "--live is given with --view, or twice"),
        (["view"], "there is no display to open the viewer on; octarm run and octarm video"),
    ):
        assert main(words) == 2, words
        assert capsys.readouterr().err.startswith(f"octarm: {sentence}")
    assert not list(Path().iterdir())


@pytest.mark.parametrize("law", ["pd", "smc-integral", "afsmc"])
def test_a_policy_moves_the_arm_as_rollout_does(law: str):
    noise = [parse_disturbance("noise:0.3"), parse_disturbance("measurement-noise:0.001")]
    controller = make_controller(law, nominal=octarm.nominal_parameters().mismatched(-0.3))
    env = octarm.load("sine", disturbances=noise, control_period=0.001)
    runs = [octarm.rollout(env, controller, 0.05) for _ in range(2)]
    env.task.next_episode = 0
    policy = Policy(env, controller)
    for run in runs:  # the state begins anew with each episode
        timestep = env.reset()
        for q, tau in zip(run.q, run.tau, strict=True):
            np.testing.assert_array_equal(env.physics.q(), q)
            action = policy(timestep)
            np.testing.assert_array_equal(action, tau)
            timestep = env.step(action)


def test_a_policy_gives_actions_that_can_be_taken_whatever_the_controller_says():
    controller = make_controller("pd", nominal=octarm.nominal_parameters())
    env = octarm.load("sine")
    timestep = env.reset()
    timestep.observation["q"][:] = np.nan
    assert np.all(Policy(env, controller)(timestep) == 0.0)
    with pytest.raises(OctarmError, match="must be an object with initial_state"):
        Policy(env, "pd")  # pyright: ignore[reportArgumentType]


def test_view_gives_the_window_an_environment_and_a_policy(monkeypatch: pytest.MonkeyPatch):
    seen = []

    def launch(environment, policy, title):
        timestep = environment.reset()
        for _ in range(5):
            timestep = environment.step(policy(timestep))
        seen.append((title, environment.physics.q()))

    monkeypatch.setattr(windows, "launch", launch)
    monkeypatch.setattr(viewer, "check_display", lambda otherwise: None)
    monkeypatch.setenv("MUJOCO_GL", os.environ.get("MUJOCO_GL", "glfw"))  # put back afterwards
    assert main(["view", "--controller", "smc", "--mismatch", "-30%"]) == 0
    nominal = octarm.nominal_parameters().mismatched(-0.3)
    controller = make_controller("smc", nominal=nominal)
    run = octarm.rollout(octarm.load("sine"), controller, 0.0025 + 0.0005)
    ((title, q),) = seen
    assert title == "smc on sine"
    np.testing.assert_array_equal(q, run.q[5])


def test_a_window_that_cannot_be_opened_is_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    def launch(*_, **__):
        raise RuntimeError("Failed to create window")

    monkeypatch.setattr(windows, "launch", launch)
    monkeypatch.setattr(viewer, "check_display", lambda otherwise: None)
    monkeypatch.setenv("MUJOCO_GL", os.environ.get("MUJOCO_GL", "glfw"))
    assert main(["view"]) == 2
    assert "the window cannot be opened: Failed to create window" in capsys.readouterr().err
    assert sys.modules["dm_control.viewer"] is windows

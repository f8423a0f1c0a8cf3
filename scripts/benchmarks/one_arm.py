"""One arm at a time: a control period of a recorded run in physics steps, and a whole run."""

from __future__ import annotations

import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable

import mujoco

import octarm
from benchmarks.figures import Row, Settings
from controllers import make_controller
from octarm.arm.mjcf import build_slim_model
from octarm.interfaces import Instant
from octarm.simulation.rollout import ArmRecorder, simulate

LAWS = ("afsmc", "smc-boundary")
TURN = 25  # control periods, and physics steps, in turns
_SECONDS = 5.0  # a law, by that many of the settings' seconds


def one_arm(settings: Settings) -> list[Row]:
    """Shortest turns of both within one loop; other programs lengthen both."""
    rows: list[Row] = []
    for law in LAWS:
        period, step = _turns(law, _SECONDS * settings.seconds)
        rows += [
            Row(f"{law}, a control period in RK4 steps", period / step, "1", at_most=10.0),
            Row(f"{law}, a control period", 1e6 * period, "us"),
            Row(f"{law}, an RK4 step of the slim model", 1e6 * step, "us"),
        ]
        duration = 10.0 * min(1.0, settings.seconds)
        times = duration / _command(law, duration)
        rows.append(Row(f"{law}, octarm run, times real time", times, "1", at_least=3.0))
    return rows


def _turns(law: str, seconds: float) -> tuple[float, float]:
    """A control period and a physics step [s]."""
    arm = octarm.nominal_parameters()
    environment, controller = octarm.load(), make_controller(law, arm.mismatched(-0.3))
    step = _stepping(build_slim_model(arm))
    periods, period, bare, begun = 0, math.inf, math.inf, time.perf_counter()
    end = begun + seconds

    def observe(instant: Instant) -> None:
        nonlocal periods, period, bare, begun
        periods += 1
        if periods % TURN == 0:
            now = time.perf_counter()
            period = min(period, (now - begun) / TURN)
            bare = min(bare, step())
            begun = time.perf_counter()
            if begun > end:
                raise _TimeIsUp

    try:
        simulate(environment, controller, 1e4, ArmRecorder(environment, lambda rows: None), observe)
    except _TimeIsUp:
        pass
    return period, bare


class _TimeIsUp(Exception):
    """Ends a measurement."""


def _stepping(model: mujoco.MjModel) -> Callable[[], float]:
    """How long a step of this model takes [s], its arm hanging."""
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)

    def turn() -> float:
        begun = time.perf_counter()
        for _ in range(TURN):
            mujoco.mj_step(model, data)
        return (time.perf_counter() - begun) / TURN

    return turn


def _command(law: str, duration: float) -> float:
    """What `octarm run` takes as a whole process [s]."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "octarm", "run", "--controller", law,
                   "--duration", str(duration), "--out", f"{folder}/run"]  # fmt: skip
        begun = time.perf_counter()
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        return time.perf_counter() - begun

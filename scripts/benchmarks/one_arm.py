"""One arm at a time: a control period of a recorded run in physics steps, and a whole run."""

from __future__ import annotations

import functools
import subprocess
import sys
import tempfile

import mujoco
import numpy as np

import octarm
from benchmarks.figures import Row, Settings, duration_of, turns
from controllers import make_controller
from octarm.arm.mjcf import build_slim_model
from octarm.simulation.rollout import ArmRecorder

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
        with tempfile.TemporaryDirectory() as folder:
            command = [sys.executable, "-m", "octarm", "run", "--controller", law,
                       "--duration", str(duration), "--out", f"{folder}/run"]  # fmt: skip
            quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
            taken = duration_of(functools.partial(subprocess.run, command, check=True, **quiet))[0]
        rows.append(Row(f"{law}, octarm run, times real time", duration / taken, "1", at_least=3.0))
    return rows


def _turns(law: str, seconds: float) -> np.ndarray:
    """A control period, and a physics step of the slim model, whose arm hangs [s]."""
    arm = octarm.nominal_parameters()
    environment, controller = octarm.load(), make_controller(law, arm.mismatched(-0.3))
    model = build_slim_model(arm)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)

    def step() -> None:
        for _ in range(TURN):
            mujoco.mj_step(model, data)

    recorder = ArmRecorder(environment, lambda rows: None)
    times = turns(environment, controller, 1e4, recorder, step, TURN, seconds)
    return np.min(times[:, :, 0], axis=0) / TURN

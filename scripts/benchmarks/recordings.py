"""What it costs to record a run: time and size of the file, against logging step by step."""

import functools
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr

import octarm
from benchmarks.figures import Row, Settings, duration_of
from controllers import CONTROLLERS, make_controller
from octarm.recordings.channels import channels_of
from octarm.recordings.recording import write_recording
from octarm.runs.experiment import Experiment, perform
from octarm.simulation.trajectory import Trajectory

PERIOD = 1e-3  # of control [s]
STEPWISE = "afsmc"  # the controller with the most signals
_STEPS = 500  # that are logged one by one
_TIMES = 3


def recording(settings: Settings) -> list[Row]:
    """Recordings of 10 s of every controller."""
    duration = max(10.0 * settings.seconds, 10 * PERIOD)
    rows: list[Row] = []
    with tempfile.TemporaryDirectory() as name:
        file = Path(name) / "run.rrd"
        for controller in CONTROLLERS:
            begun = time.perf_counter()
            run, description = _run(controller, duration)
            taken = time.perf_counter() - begun
            write = functools.partial(write_recording, file, run, description)
            writing = float(np.median([duration_of(write)[0] for _ in range(_TIMES)]))
            size, share = file.stat().st_size / 1e6, 100.0 * writing / taken
            rows += [
                Row(f"{controller}, {duration:g} s at 1 kHz, its file", size, "MB", at_most=4.0),
                Row(f"{controller}, writing within the run's time", share, "%", at_most=10.0),
            ]
            if controller == STEPWISE:
                rows += _stepwise(Path(name), run, description, writing / len(run))
    return rows


def _run(controller: str, duration: float) -> tuple[Trajectory, dict[str, Any]]:
    arm = octarm.nominal_parameters()
    experiment = Experiment(
        controller=controller,
        gains={},
        nominal=arm.mismatched(-0.3),
        parameters=arm,
        reference="sine",
        duration=duration,
        control_period=PERIOD,
    )
    environment, made = experiment.begin(make_controller)
    return perform(environment, made, experiment.announcement(environment, made))


def _stepwise(
    folder: Path, run: Trajectory, description: Mapping[str, Any], recorded: float
) -> list[Row]:
    """`rr.log` of the same signals at every instant, against a step of the recorder [s].

    The recorder also draws the arm and records the rules, 60 times a second; that is not logged.
    """
    rows = dict(run.arrays())
    channels = channels_of(rows, description, run.layer, disturbed=False)
    lists: dict[str, np.ndarray] = {}  # what the recorder holds together
    for channel in channels.values():
        if channel.kind != "rules":
            lists |= channel.columns(channel.values(rows))
    numbers = {f"{name}/{i}": x for name, table in lists.items() for i, x in enumerate(table.T)}
    a_number, a_list = (_logged(folder / "steps.rrd", run, kind) for kind in (numbers, lists))
    return [
        Row(f"{STEPWISE}, recorded, a step", 1e6 * recorded, "us"),
        Row(f"{STEPWISE}, rr.log of every number, a step", 1e6 * a_number, "us"),
        Row("how much faster it is recorded", a_number / recorded, "1", at_least=50.0),
        Row(f"{STEPWISE}, rr.log of every list, a step", 1e6 * a_list, "us"),
        Row("how much faster than that", a_list / recorded, "1"),
    ]


def _logged(file: Path, run: Trajectory, fields: dict[str, np.ndarray]) -> float:
    """How long a step takes with an entity for each field [s]."""
    steps = min(_STEPS, len(run))
    begun = time.perf_counter()
    with rr.RecordingStream("octarm", send_properties=False) as stream:
        stream.save(file)
        for i in range(steps):
            stream.set_time("t", duration=run.t[i])
            stream.set_time("step", sequence=i)
            for name, rows in fields.items():
                stream.log(name, rr.Scalars(rows[i]))
    return (time.perf_counter() - begun) / steps

"""What `octarm run` does."""

from __future__ import annotations

import contextlib
import datetime
import functools
import shlex
import sys
import time
from pathlib import Path

import numpy as np
from tqdm import tqdm

from controllers import make_controller
from octarm.bars import bar as new_bar
from octarm.commands.notes import print_late, print_unsuited, starts_of
from octarm.commands.summary import summary
from octarm.commands.terminal import note
from octarm.declared import short_name, word_of
from octarm.errors import ExitCode, OctarmError, printable
from octarm.recordings import viewer
from octarm.recordings.live import LiveRecording
from octarm.recordings.recording import run_recording
from octarm.references import recorded_word
from octarm.runs import folder as runs
from octarm.runs.experiment import Experiment, run_into
from octarm.simulation.environment import whole_periods


def run(
    experiment: Experiment,
    gain_set: str | None,
    out: Path | None,
    view: bool,
    live: str | None = None,
) -> int:
    """`octarm run`: one controller against the arm, as a run folder.

    `live` is the address of a viewer that shows it meanwhile; if empty, a window is opened.
    """
    with contextlib.nullcontext() if live is None else viewer.open_for_run(live) as url:
        return _run(experiment, gain_set, out, view, url)


def _run(
    experiment: Experiment, gain_set: str | None, out: Path | None, view: bool, url: str | None
) -> int:
    environment, controller = experiment.begin(
        functools.partial(make_controller, gain_set=gain_set)
    )
    announced = experiment.announcement(environment, controller)
    period = environment.control_timestep()
    label = short_name(word_of(experiment.controller, experiment.code))
    far = print_unsuited(label, gain_set, experiment.nominal, None, period)
    periods = whole_periods(experiment.duration, period)
    word = recorded_word(experiment.reference, experiment.code)
    print_late(starts_of(experiment.disturbances), [word], experiment.duration)
    out = out or _dated_folder(experiment.controller)

    def say(sentence: str) -> None:
        tqdm.write(f"octarm: {sentence}", file=sys.stderr)  # above the bar

    started, ends = time.perf_counter(), list[np.ndarray]()  # of the reference, block by block
    with new_bar(total=periods, unit=" periods") as bar:
        trajectory, description = run_into(
            out,
            environment,
            controller,
            announced,
            recording=run_recording,
            progress=bar.update,
            keep=lambda rows: ends.extend([rows["q_d"].min(axis=0), rows["q_d"].max(axis=0)]),
            live=None if url is None else LiveRecording(url, announced, say),
        )
    elapsed = time.perf_counter() - started
    amplitude = 0.5 * np.ptp(ends, axis=0)
    print(summary(len(trajectory), amplitude, description, elapsed, experiment.code))
    print(f"wrote {printable(str(out))}/  ({runs.RECORDING}, {runs.ARRAYS}, {runs.DESCRIPTION})")
    if trajectory.status == "interrupted":
        raise KeyboardInterrupt(f"{out} holds the run up to t = {trajectory.t[-1]:.6g} s")
    if trajectory.status == "diverged":
        advice = (
            "; its gains are for another arm or control period, try --gains recommended, --gain "
            "NAME:VALUE, or a shorter --control-period"
        )
        note(f"the run {trajectory.message}; it was kept up to there{advice if far else ''}")
        return ExitCode.DIVERGED
    if view:
        _view(out)
    else:
        print(f"see it: octarm replay {printable(shlex.quote(str(out)))}")
    return ExitCode.FINE


def _view(folder: Path) -> None:
    """Opens the viewer on a fresh run; without a display the run is still fine."""
    try:
        viewer.open_viewer([folder / runs.RECORDING])
    except OctarmError as error:
        print(f"the viewer did not open: {error}")
        name = printable(shlex.quote(str(folder)))
        print(f"a picture: octarm replay {name} --screenshot picture.png")


def _dated_folder(controller: str) -> Path:
    return Path("runs") / f"{datetime.datetime.now():%Y%m%d-%H%M%S.%f}-{controller}"

"""What `octarm run` does."""

from __future__ import annotations

import contextlib
import datetime
import functools
import itertools
import shlex
import sys
import time
from pathlib import Path

import numpy as np
from dm_control.rl import control
from tqdm import tqdm

from controllers import make_controller
from octarm.arm.modes import growth_rate
from octarm.bars import bar as new_bar
from octarm.commands.gain_notes import print_unsuited
from octarm.commands.summary import summary
from octarm.declared import samples_of, short_name, word_of
from octarm.errors import ExitCode, OctarmError, printable
from octarm.recordings import viewer
from octarm.recordings.live import LiveRecording
from octarm.recordings.recording import run_recording
from octarm.references import recorded_word
from octarm.references.samples import samples_end
from octarm.runs import folder as runs
from octarm.runs.experiment import Experiment, run_into
from octarm.simulation.environment import whole_periods
from octarm.simulation.physics import ArmPhysics


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
    for event in (event for each in experiment.disturbances for event in each.events()):
        if event.text and event.at >= experiment.duration:
            begins = f"{event.text} begins at {event.at:g} s, and the run ends at"
            print(f"octarm: {begins} {experiment.duration:g} s before it", file=sys.stderr)
    file = samples_of(recorded_word(experiment.reference, experiment.code))
    if file is not None:
        ends_at = samples_end(file, experiment.parameters.modules)
        if ends_at < experiment.duration * (1.0 - 1e-9):
            print(
                f"octarm: the samples of {printable(str(file))} end at {ends_at:.4g} s, and the "
                f"run at {experiment.duration:g} s: from then on the arm is to rest there",
                file=sys.stderr,
            )
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
        advice = _advice(far, environment)
        message = f"the run {trajectory.message}; it was kept up to there{advice}"
        print(f"octarm: {message}", file=sys.stderr)
        return ExitCode.DIVERGED
    if view:
        _view(out)
    else:
        print(f"see it: octarm replay {printable(shlex.quote(str(out)))}")
    return ExitCode.FINE


def _advice(far: str, environment: control.Environment) -> str:
    """What a run that diverged may be due to: an arm that does not stay where it hangs, or gains.

    A sentence `far` says that the gains were found for another arm, see `print_unsuited`.
    """
    physics: ArmPhysics = environment.physics
    growth = float(growth_rate(physics.plant().parameters, physics.plant_rest()))
    if growth > 0.0:
        return (
            "; without control this arm does not stay where it hangs: a mode grows e-fold in "
            f"{1.0 / growth:.3g} s"
        )
    if far:
        return (
            "; its gains are for another arm or control period, try --gains recommended, --gain "
            "NAME:VALUE, or a shorter --control-period"
        )
    return ""


def _view(folder: Path) -> None:
    """Opens the viewer on a fresh run; without a display the run is still fine."""
    try:
        viewer.open_viewer([folder / runs.RECORDING])
    except OctarmError as error:
        print(f"the viewer did not open: {error}")
        name = printable(shlex.quote(str(folder)))
        print(f"a picture: octarm replay {name} --screenshot picture.png")


def _dated_folder(controller: str) -> Path:
    now = datetime.datetime.now().strftime("%Y%m%d-%H%M%S.%f")[:-3]
    base = Path("runs") / f"{now}-{controller}"
    names = itertools.chain([base], (Path(f"{base}-{i}") for i in itertools.count(2)))
    return next(name for name in names if not name.exists())

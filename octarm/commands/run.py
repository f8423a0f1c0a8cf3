"""What `octarm run` does."""

from __future__ import annotations

import contextlib
import datetime
import functools
import shlex
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from controllers import make_controller
from octarm.arm.groups import SUMS
from octarm.bars import bar as new_bar
from octarm.commands.notes import print_late, print_unsuited, starts_of
from octarm.commands.terminal import note
from octarm.declared import short_name, word_of
from octarm.disturbances.ledger import in_words
from octarm.errors import ExitCode, OctarmError, printable
from octarm.metrics.metric import unsettled
from octarm.metrics.table import METRICS, declared_metrics
from octarm.recordings import viewer
from octarm.recordings.recording import run_recording
from octarm.recordings.viewing import LiveRecording
from octarm.runs import folder as runs
from octarm.runs.experiment import Experiment, run_into
from octarm.simulation.environment import whole_periods

# Those of the table of a run, with their widths.
_COLUMNS = {
    "rms": 10, "peak": 11, "rms/amplitude": 15, "overshoot": 11, "chattering": 14,
    "reached s=0": 13,
}  # fmt: skip


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
    starts, motions = starts_of(experiment.disturbances), [experiment.reference]
    print_late(starts, motions, experiment.code, experiment.duration)
    date = f"{datetime.datetime.now():%Y%m%d-%H%M%S.%f}"
    out = out or Path("runs") / f"{date}-{experiment.controller}"

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
    _print_summary(experiment, description, len(trajectory), amplitude, elapsed)
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


def _print_summary(
    experiment: Experiment,
    description: Mapping[str, Any],
    periods: int,
    amplitude: np.ndarray,
    elapsed: float,
) -> None:
    """Says what was run, what the disturbances delivered, and what came of it.

    Of so many control periods, a desired motion with amplitudes of shape (2N,) [m], [rad], what
    run.json says, and how long it took [s].
    """
    period, metrics = description["control_period"], description["metrics"]
    on = ""
    if plant := description.get("plant"):
        read = "" if plant["sensing"] == SUMS else f", read by {plant['sensing']}"
        on = f", a plant of {plant['modules']} modules ({plant['layout']}{read})"
    print(
        f"{description['controller']['name']} on {description['reference']['name']}{on}: "
        f"{periods * period:g} s at {1.0 / period:g} Hz, done in {elapsed:.1f} s"
    )
    if description["disturbances"]:
        print("disturbances, as delivered")
        print("\n".join(in_words(description["disturbances"], experiment.code)))
    if None not in metrics["rms_error"]:
        _print_table(amplitude, description["coordinates"], metrics, experiment.settle)
    elif early := unsettled(experiment.duration, experiment.settle):
        print(f"note: {early}")
    for name, metric in declared_metrics(experiment.code).items():
        if name not in METRICS and name in metrics:
            numbers = np.atleast_1d(np.array(metrics[name], dtype=float))
            values = ", ".join("none" if np.isnan(x) else f"{x:.3g}" for x in numbers.tolist())
            print(f"{name} [{', '.join(metric.units)}]: {values}")


def _print_table(
    amplitude: np.ndarray,
    coordinates: Sequence[Mapping[str, str]],
    metrics: Mapping[str, Any],
    settle: float,
) -> None:
    """A row a coordinate."""

    def print_row(head: str, cells: Iterable[str]) -> None:
        print(head.ljust(14) + "".join(map(str.rjust, cells, _COLUMNS.values())).rstrip())

    print_row(f"after {settle:g} s", _COLUMNS)
    for j, coordinate in enumerate(coordinates):
        name, unit = coordinate["name"], coordinate["unit"]
        force = METRICS["chattering"].unit_for(unit)
        rms = metrics["rms_error"][j]
        reached = metrics.get("reaching_time")
        cells = (
            f"{1e3 * rms:.3g}",
            f"{1e3 * metrics['peak_error'][j]:.3g}",
            _cell(100.0 * rms / amplitude[j] if amplitude[j] > 0.0 else None, ".3f", " %"),
            _cell(metrics["overshoot"][j], "+.2f", " %"),
            _cell(metrics["chattering"][j], ".3g", f" m{force}", 1e3),
            _cell(reached[j] if reached else None, ".4g", " s"),
        )
        print_row(f"{name:>7} [m{unit}]", cells)
    bound = metrics.get("reaching_bound")
    promise = "" if bound is None else f"; s = 0 is reached within {bound:.3g} s by (14)-(15)"
    print(f"tip: {1e3 * metrics['tip_rms_error']:.3g} mm rms{promise}")


def _cell(value: float | None, form: str, unit: str, factor: float = 1.0) -> str:
    return "" if value is None else f"{factor * value:{form}}{unit}"

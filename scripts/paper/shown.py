"""The single runs that figure 1 shows, as run folders with a recording each."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from octarm.arm.mjcf import nominal_parameters
from octarm.recordings.recording import run_recording
from octarm.runs import folder as runs
from octarm.runs.experiment import Experiment, run_into
from paper.effort import Effort
from paper.series import name_of, readings, shown
from paper.studies import MODELS
from paper.variants import Cast, Factory, Variant


class Shown(NamedTuple):
    """A run of one arm without noise.

    Attributes:
        name: of its folder.
        variant: what controls it.
        reference: what it shall do.
        mismatch: of the nominal model [1].
        duration: [s].
    """

    name: str
    variant: Variant
    reference: str
    mismatch: float
    duration: float

    @property
    def seconds(self) -> float:
        """What is simulated, weighed by what a single arm costs beside one of a batch [s]."""
        return 8.0 * self.duration


def requests(cast: Cast, effort: Effort) -> Iterator[Shown]:
    """All lines of figure 1."""
    for reference in readings(effort) if effort.complete else ():
        for label in shown(effort):
            for model in MODELS:
                name = f"{name_of(label, reference)}-{100 * model:+.0f}"
                yield Shown(name, cast[label], reference, model, effort.short)


def record(request: Shown, factory: Factory, folder: Path) -> None:
    """Runs it into a folder, unless it is there."""
    if (folder / runs.RECORDING).is_file() and (folder / runs.ARRAYS).is_file():
        return
    true = nominal_parameters()
    experiment = Experiment(
        controller=request.variant.controller,
        gains=request.variant.gains,
        nominal=true.mismatched(request.mismatch),
        parameters=true,
        reference=request.reference,
        duration=request.duration,
    )
    environment, controller = experiment.begin(factory)
    announced = experiment.announcement(environment, controller)
    run_into(folder, environment, controller, announced, recording=run_recording, partial=False)

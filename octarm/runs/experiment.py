"""All that a run of one arm depends on, how it is run into a folder, and back from `run.json`."""

from __future__ import annotations

import contextlib
import dataclasses
import shlex
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from dm_control.rl import control

from octarm.arm.parameters import ArmParameters
from octarm.disturbances.episode import Disturbance
from octarm.disturbances.ledger import Ledger, asked
from octarm.disturbances.spelling import from_entry
from octarm.errors import OctarmError, closest
from octarm.interfaces import Controller
from octarm.interrupts import ignored_interrupts
from octarm.references import REFERENCES
from octarm.runs import folder as runs
from octarm.runs.archive import Archive, Ending, mapped
from octarm.runs.versions import host, versions
from octarm.simulation.environment import TrackingTask, load, whole_periods
from octarm.simulation.rollout import joined, stream
from octarm.simulation.trajectory import Trajectory

if TYPE_CHECKING:
    from octarm.recordings.recording import Recorder

# Name, nominal model and gains to controller; `controllers.make_controller` is one.
Factory = Callable[[str, ArmParameters, Mapping[str, Any]], Controller]

_INPUTS = ("controller", "parameters", "nominal", "reference", "disturbances", "seed", "duration",
           "timestep", "control_period", "actuation")  # fmt: skip


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Experiment:
    """All that a run of one arm depends on.

    Attributes:
        controller: name.
        gains: those that the factory of controllers is given.
        nominal: the model of the arm that the controller is given.
        parameters: the true arm.
        reference: name of the desired motion.
        disturbances: what acts on the arm that the controller does not know.
        seed: of all that is random.
        spawn_key: of the `SeedSequence` that has this seed; empty but for episodes of sweeps.
        duration: of the run [s].
        timestep: physics step [s]; that of models/octarm.xml when None.
        control_period: time between control actions [s]; one physics step when None.
        actuation: see `octarm.arm.actuation`.
    """

    controller: str
    gains: Mapping[str, Any]
    nominal: ArmParameters
    parameters: ArmParameters
    reference: str
    disturbances: tuple[Disturbance, ...] = ()
    seed: int = 0
    spawn_key: tuple[int, ...] = ()
    duration: float
    timestep: float | None = None
    control_period: float | None = None
    actuation: str = "f-coeff"

    def begin(self, factory: Factory) -> tuple[control.Environment, Controller]:
        """The environment and the controller.

        Raises:
            ValueError: if one of them cannot be made.
        """
        seed = self.seed
        if self.spawn_key:
            seed = np.random.SeedSequence(self.seed, spawn_key=self.spawn_key)
        environment = load(
            self.reference,
            disturbances=self.disturbances,
            parameters=self.parameters,
            timestep=self.timestep,
            control_period=self.control_period,
            actuation=self.actuation,
            seed=seed,
        )
        return environment, factory(self.controller, self.nominal, self.gains)

    def announcement(
        self, environment: control.Environment, controller: Controller
    ) -> dict[str, Any]:
        """The content of `run.json` before the run, given what `begin` made."""
        task: TrackingTask = environment.task
        return {
            "controller": {"name": self.controller, "gains": runs.gains_of(controller)},
            "parameters": self.parameters.to_dict(),
            "nominal": self.nominal.to_dict(),
            "reference": {"name": self.reference, **runs.describe_fields(task.reference)},
            "disturbances": asked(task.disturbances),
            "seed": self.seed,
            "spawn_key": list(self.spawn_key),
            "duration": self.duration,
            "timestep": environment.physics.timestep(),
            "control_period": environment.control_timestep(),
            "actuation": self.actuation,
            "metrics": {},
            "status": runs.RUNNING,
            "message": "",
            "versions": versions(),
            "host": host(),
            "digest": "",
            "command": shlex.join(["octarm", *sys.argv[1:]]),
        }

    @classmethod
    def from_description(cls, description: Mapping[str, Any]) -> Experiment:
        """What was run, from the content of `run.json`; its factory is to be given all the gains.

        Raises:
            ValueError: if something is missing or not allowed, or the reference is a custom one.
        """
        missing = [key for key in _INPUTS if key not in description]
        if missing:
            raise OctarmError(f"{runs.DESCRIPTION} lacks {', '.join(missing)}: no run to repeat")
        try:
            return cls._of(description)
        except (AttributeError, IndexError, KeyError, TypeError) as error:
            raise OctarmError(
                f"{runs.DESCRIPTION} does not say what was run: {type(error).__name__}, {error}"
            ) from None

    @classmethod
    def _of(cls, description: Mapping[str, Any]) -> Experiment:
        reference = description["reference"]["name"]
        if reference not in REFERENCES:
            raise OctarmError(
                f"the run followed a custom reference, {reference!r}, which its folder does not "
                f"hold{closest(str(reference), REFERENCES)}"
            )
        gains = description["controller"]["gains"]
        return cls(
            controller=description["controller"]["name"],
            gains={name.rstrip("_"): value for name, value in gains.items()},
            nominal=ArmParameters.from_dict(description["nominal"]),
            parameters=ArmParameters.from_dict(description["parameters"]),
            reference=reference,
            disturbances=tuple(map(from_entry, description["disturbances"])),
            seed=description["seed"],
            spawn_key=tuple(description.get("spawn_key", ())),
            duration=float(description["duration"]),
            timestep=float(description["timestep"]),
            control_period=float(description["control_period"]),
            actuation=description["actuation"],
        )


def perform(
    environment: control.Environment,
    controller: Controller,
    announced: Mapping[str, Any],
    *,
    progress: Callable[[], object] | None = None,
) -> tuple[Trajectory, dict[str, Any]]:
    """Runs an experiment that was begun and announced, in memory.

    Args:
        environment: from `Experiment.begin`.
        controller: likewise.
        announced: from `Experiment.announcement`.
        progress: called after every control period.

    Returns:
        The trajectory, and the content of `run.json`: also what came of the run.
    """
    blocks: list[Trajectory] = []
    ending, description = _perform(environment, controller, announced, blocks.append, progress)
    return joined(blocks, ending), description


def _perform(
    environment: control.Environment,
    controller: Controller,
    announced: Mapping[str, Any],
    keep: Callable[[Trajectory], object],
    progress: Callable[[], object] | None,
) -> tuple[Ending, dict[str, Any]]:
    """Runs an experiment of any length, whose rows are handed to `keep`."""
    task, physics = environment.task, environment.physics
    ledger = Ledger(task.disturbances, physics) if task.disturbances else None
    if ledger is not None:
        physics.watch = ledger.step
    measured = runs.Measured(
        control_period=environment.control_timestep(),
        input_limit=physics.input_limit(),
        phi=getattr(controller, "phi", None),
    )

    def take_up(rows: Trajectory) -> None:
        keep(rows)
        measured.add(rows)

    duration = announced["duration"]
    ending = stream(environment, controller, duration, keep=take_up, progress=progress)
    return ending, {
        **announced,
        "disturbances": ledger.rows() if ledger is not None else [],
        "metrics": measured.numbers(diverged=ending.status == "diverged"),
        **ending._asdict(),
    }


def run_into(
    out: Path,
    environment: control.Environment,
    controller: Controller,
    announced: Mapping[str, Any],
    *,
    progress: Callable[[], object] | None = None,
    keep: Callable[[Trajectory], object] | None = None,
    partial: bool = True,
) -> tuple[Trajectory, dict[str, Any]]:
    """Runs an experiment of any length into a run folder: recording, arrays and description.

    Args:
        out: the folder; an earlier run there is replaced when this one is complete.
        environment: from `Experiment.begin`.
        controller: likewise.
        announced: from `Experiment.announcement`.
        progress: called after every control period.
        keep: called with every block of rows, when it is on disk.
        partial: whether a run that is interrupted is kept up to there, with the status
            `interrupted`, unless there is an earlier one.

    Returns:
        The trajectory, whose arrays stay on disk until they are looked at, and the content of
        `run.json`.

    Raises:
        ValueError: if the place is taken by something else.
        OSError: if it cannot be written.
        RuntimeError: if the run cannot be recorded.
        KeyboardInterrupt: if interrupted, and nothing was kept.
    """
    rows = whole_periods(announced["duration"], environment.control_timestep())
    with contextlib.ExitStack() as peace, runs.new_folder(out) as folder:
        runs.announce(folder, announced)
        with Archive(folder / runs.BLOCKS, rows=rows) as archive:
            with _recorder(folder / runs.RECORDING, announced) as recorder:

                def take_up(block: Trajectory) -> None:
                    archive.add(block)
                    recorder.add(block)
                    if keep is not None:
                        keep(block)

                archive.ending, description = _perform(
                    environment, controller, announced, take_up, progress
                )
                interrupted = archive.ending.status == "interrupted"
                if interrupted and (not partial or folder != out.resolve()):
                    raise KeyboardInterrupt  # the earlier run stays
                peace.enter_context(ignored_interrupts())
                recorder.finish(description)
            runs.write_run(folder, archive, description)
    return mapped(out / runs.ARRAYS), description


def _recorder(path: Path, announced: Mapping[str, Any]) -> Recorder:
    from octarm.recordings.recording import Recorder  # imports rerun, which takes half a second

    return Recorder(path, announced)

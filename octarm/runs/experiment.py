"""All that a run of one arm depends on, how it is run into a folder, and back from `run.json`."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import shlex
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from dm_control.rl import control

from octarm.arm.groups import PAPER, SUMS, Groups
from octarm.arm.parameters import ArmParameters
from octarm.declared import Code, word_of
from octarm.disturbances.ledger import Ledger, asked
from octarm.disturbances.spelling import from_entry
from octarm.errors import OctarmError, closest, quoted
from octarm.formats import Document
from octarm.interfaces import Controller, ControllerFactory, Rows
from octarm.interrupts import ignored_interrupts
from octarm.metrics.metric import SETTLED_AFTER
from octarm.metrics.table import Catalogue, Metrics, as_json, code_of
from octarm.metrics.table import measured as measured_by
from octarm.references import REFERENCES, recorded_word
from octarm.runs import folder as runs
from octarm.runs.description import REPEATED, USUAL, Description, unusual
from octarm.runs.folder import Archive
from octarm.runs.place import new_folder
from octarm.runs.versions import host, versions
from octarm.simulation.environment import whole_periods
from octarm.simulation.rollout import ArmRecorder, Observer, copied
from octarm.simulation.setup import Setup
from octarm.simulation.stepping import AnyPhysics
from octarm.simulation.task import TrackingTask
from octarm.simulation.trajectory import Ending, Trajectory, joined

_LIVE = 500  # rows of a block that is to be seen while the run goes on
_AS_THEY_ARE = {
    "seed", "spawn_key", "duration", "timestep", "control_period", "actuation", "integrator",
    "engine", *USUAL,
}  # fmt: skip


class Recording(Protocol):
    """A recording that is written while the run goes on; see `octarm.recordings.recording`."""

    def add(self, rows: Rows, layer: np.ndarray | None) -> None:
        """Takes further rows, and the half width of the boundary layer, shape (2N,)."""
        ...

    def finish(self, description: Mapping[str, Any]) -> None:
        """Takes the complete description, with which the recording ends."""
        ...


# Opens the file of a recording, given the description that announces the run.
OpenRecording = Callable[
    [Path, Mapping[str, Any]], contextlib.AbstractContextManager[Recording, bool | None]
]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Experiment(Setup):
    """All that a run of one arm depends on; see `octarm.load` for what is not said here.

    Attributes:
        gains: those that the factory of controllers is given.
        nominal: the model of the arm that the controller is given.
        spawn_key: of the `SeedSequence` that has this seed; empty but for episodes of sweeps.
        duration: of the run [s].
        settle: when metrics of the steady regime begin [s].
        code: what is not built in by name, and metrics that are measured as well.
    """

    controller: str
    gains: Mapping[str, Any]
    nominal: ArmParameters
    seed: int = 0
    spawn_key: tuple[int, ...] = ()
    duration: float
    settle: float = SETTLED_AFTER
    code: Mapping[str, Code] = dataclasses.field(default_factory=dict[str, Code])

    def begin(self, factory: ControllerFactory) -> tuple[control.Environment, Controller]:
        """The environment and the controller.

        Raises OctarmError if one of them cannot be made, CodeChanged if its code is not what it
        was.
        """
        seed = self.seed
        if self.spawn_key:
            seed = np.random.SeedSequence(self.seed, spawn_key=self.spawn_key)
        reference = recorded_word(self.reference, self.code)
        environment = self.load(self.nominal, reference=reference, seed=seed)
        controller = word_of(self.controller, self.code)
        return environment, factory(controller, self.nominal, self.gains)

    def announcement(
        self, environment: control.Environment, controller: Controller
    ) -> dict[str, Any]:
        """The content of `run.json` before the run, given what `begin` made."""
        task: TrackingTask = environment.task
        physics: AnyPhysics = environment.physics
        fields = runs.describe_fields(task.reference)
        coordinates = zip(physics.coordinates.names, physics.coordinates.units, strict=True)
        return {
            "controller": {"name": self.controller, "gains": runs.gains_of(controller)},
            "parameters": task.arm.to_dict(),
            "coordinates": [{"name": name, "unit": unit} for name, unit in coordinates],
            "nominal": self.nominal.to_dict(),
            "reference": {"name": self.reference} | fields | {"name": self.reference},
            "code": {name: each.model_dump() for name, each in self.code.items()},
            "disturbances": asked(task.disturbances),
            "seed": self.seed,
            "spawn_key": list(self.spawn_key),
            "duration": self.duration,
            "timestep": physics.timestep(),
            "control_period": environment.control_timestep(),
            "actuation": self.actuation,
            "integrator": self.integrator,
            "engine": self.engine,
            **unusual(self),
            **self._plant(physics.groups),
            "metrics": {},
            "status": runs.RUNNING,
            "message": "",
            "versions": versions(self.engine, self.code),
            "host": host(),
            "digest": "",
            # Names of files may be any bytes; a text file may not.
            "command": os.fsencode(shlex.join(["octarm", *sys.argv[1:]])).decode(
                "utf-8", "backslashreplace"
            ),
        }

    def _plant(self, groups: Groups | None) -> dict[str, Any]:
        """What `run.json` says of a plant of more modules, and of what is measured of it."""
        if groups is None:
            return {}
        table: dict[str, Any] = {"modules": groups.plant.modules, "layout": groups.layout}
        table["sensing"] = self.sensing
        if self.plant_modules is None:
            table["parameters"] = self.parameters.to_dict()
        table["map"] = {"matrix": groups.matrix.tolist(), "offset": groups.offset.tolist()}
        return {"plant": table}

    @classmethod
    def from_description(cls, description: Mapping[str, Any]) -> Experiment:
        """What was run, from the content of `run.json`; its factory is to be given all the gains.

        Raises OctarmError if something is missing or not allowed, or the reference is a custom one,
        CodeChanged if the code of a disturbance is not what it was.
        """
        document = Document(runs.DESCRIPTION, description)
        inputs = document.read(Description)
        for key in REPEATED:
            if description.get(key) is None:
                raise document.error(f"it needs a value of {key}", key)
        reference = inputs.reference.name
        if {reference, reference.partition(":")[0]}.isdisjoint({*REFERENCES, *inputs.code}):
            raise OctarmError(
                f"the run followed a custom reference, {quoted(reference)}, which its folder does "
                f"not hold{closest(reference, REFERENCES)}"
            )
        numbers = inputs.model_dump(include=_AS_THEY_ARE)
        gains, plant = inputs.controller.gains, inputs.plant
        itself = plant.parameters if plant else None
        chain = None if itself else plant
        return cls(
            controller=inputs.controller.name,
            gains={name.rstrip("_"): value for name, value in gains.items()},
            nominal=ArmParameters.from_dict(inputs.nominal),
            parameters=ArmParameters.from_dict(itself or inputs.parameters),
            reference=reference,
            disturbances=tuple(
                from_entry(entry.model_dump(), inputs.code) for entry in inputs.disturbances
            ),
            code=inputs.code,
            plant_modules=chain and chain.modules,
            layout=chain.layout if chain else PAPER,
            sensing=plant.sensing if plant else SUMS,
            **numbers,
        )


def metrics_of(
    environment: control.Environment, layer: Any, settle: float, catalogue: Catalogue
) -> Metrics:
    """What measures runs of an environment under a controller with a boundary layer, or None."""
    physics: AnyPhysics = environment.physics
    return Metrics(
        control_period=environment.control_timestep(),
        input_range=physics.reachable_inputs(),
        layer=layer,
        settle=settle,
        actuation=physics.actuation,
        catalogue=catalogue,
    )


def perform(
    environment: control.Environment,
    controller: Controller,
    announced: Mapping[str, Any],
    *,
    progress: Callable[[], object] | None = None,
) -> tuple[Trajectory, dict[str, Any]]:
    """Runs an experiment that was begun and announced, in memory; see `Experiment`.

    Returns:
        The trajectory, and the content of `run.json`: also what came of the run.
    """
    blocks: list[Rows] = []
    ending, description = _perform(
        environment, controller, announced, lambda rows, _: blocks.append(copied(rows)), progress
    )
    return joined(blocks, ending), description


def run_into(
    out: Path,
    environment: control.Environment,
    controller: Controller,
    announced: Mapping[str, Any],
    *,
    recording: OpenRecording,
    progress: Callable[[], object] | None = None,
    keep: Callable[[Rows], object] | None = None,
    partial: bool = True,
    live: Recording | None = None,
) -> tuple[Trajectory, dict[str, Any]]:
    """Runs an experiment that was begun and announced, of any length, into a run folder.

    Args:
        out: the folder; an earlier run there is replaced when this one is complete.
        environment: from `Experiment.begin`.
        controller: likewise.
        announced: from `Experiment.announcement`.
        recording: opens the recording.
        progress: called after every control period.
        keep: called with every block of rows, when it is on disk.
        partial: whether a run that is interrupted is kept up to there, unless there is an earlier
            one.
        live: takes the same rows in smaller blocks, as they come, and the complete description.

    Returns:
        The trajectory, whose arrays stay on disk until they are looked at, and what `run.json`
            holds.

    Raises:
        OctarmError: if the place is taken by something else, or cannot be written.
        KeyboardInterrupt: if interrupted, and nothing was kept.
    """
    expected = whole_periods(announced["duration"], environment.control_timestep())
    with contextlib.ExitStack() as closing, new_folder(out) as folder:
        runs.write_description(folder, announced)  # it stays if the process is killed
        with Archive(folder / runs.BLOCKS, rows=expected) as archive:
            with recording(folder / runs.RECORDING, announced) as recorder:

                def take_up(rows: Rows, layer: np.ndarray | None) -> None:
                    archive.add(rows, layer)
                    recorder.add(rows, layer)
                    if keep is not None:
                        keep(rows)

                ending, description = _perform(
                    environment, controller, announced, take_up, progress, live
                )
                interrupted = ending.status == "interrupted"
                if interrupted and (not partial or folder != out.resolve()):
                    raise KeyboardInterrupt  # the earlier run stays
                closing.enter_context(ignored_interrupts())
                recorder.finish(description)
            archive.save(folder / runs.ARRAYS, ending)
        trajectory = Trajectory.load(folder / runs.ARRAYS, mapped=True)
        runs.write_description(folder, description)
    return trajectory, description


def _perform(
    environment: control.Environment,
    controller: Controller,
    announced: Mapping[str, Any],
    keep: Callable[[Rows, np.ndarray | None], object],
    progress: Callable[[], object] | None,
    live: Recording | None = None,
) -> tuple[Ending, dict[str, Any]]:
    """Runs an experiment of any length, whose rows and boundary layer are handed to `keep`."""
    disturbances, physics = environment.task.disturbances, environment.physics
    ledger = Ledger(disturbances, physics) if disturbances else None
    if ledger is not None:
        physics.watch = ledger.step
    measured: list[Metrics] = []
    catalogue = measured_by(code_of(announced))

    def take_up(rows: Rows) -> None:
        keep(rows, recorder.layer)
        if not measured:
            settle = announced.get("settle", SETTLED_AFTER)
            measured.append(metrics_of(environment, recorder.layer, settle, catalogue))
        measured[0].update(rows)

    recorder = ArmRecorder(environment, take_up)
    observers: list[Observer] = [] if progress is None else [lambda _: progress()]
    watcher: ArmRecorder | None = None
    if live is not None:
        watcher = ArmRecorder(environment, lambda rows: live.add(rows, recorder.layer), rows=_LIVE)
        observers.append(watcher)
    ending = recorder.run(controller, announced["duration"], *observers)
    metrics = measured[0].result(diverged=ending.status == "diverged")
    description = {
        **announced,
        "disturbances": ledger.rows() if ledger is not None else [],
        "metrics": as_json(metrics),
        "status": ending.status,
        "message": ending.message,
        "digest": ending.digest,
    }
    if watcher is not None and live is not None:
        watcher.flush()
        live.finish(description)
    return ending, description

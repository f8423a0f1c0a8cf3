"""What the commands do."""

from __future__ import annotations

import dataclasses
import datetime
import itertools
import json
import shlex
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from dm_control.rl import control
from tqdm import tqdm

from controllers import make_controller
from octarm import runs
from octarm.disturbances import parse_disturbance
from octarm.environment import TrackingTask, load, whole_periods
from octarm.errors import ExitCode, closest
from octarm.files import write_text
from octarm.interfaces import Controller
from octarm.ledger import Ledger, in_words
from octarm.metrics import SETTLED_AFTER
from octarm.model import coordinate_names, nominal_parameters
from octarm.parameters import ArmParameters
from octarm.rollout import rollout
from octarm.trajectory import Trajectory

if TYPE_CHECKING:
    from octarm.cli import Replay, Run, Validate


def run(options: Run) -> int:
    """`octarm run`: one controller against the arm, as a run folder."""
    true = _true_parameters(options)
    nominal = true.mismatched(options.mismatch).scaled(**named_values("--nominal", options.nominal))
    controller = make_controller(options.controller, nominal, _gains(options.gain))
    disturbances = [parse_disturbance(text) for text in options.disturbance]
    environment = load(
        options.reference,
        disturbances=disturbances,
        parameters=true,
        timestep=options.timestep,
        control_period=options.control_period,
        actuation=options.actuation,
        seed=options.seed,
    )
    periods = whole_periods(options.duration, environment.control_timestep())
    out = options.out or _dated_folder(options.controller)
    with runs.new_folder(out) as folder:
        started = time.perf_counter()
        with tqdm(total=periods, unit=" periods", disable=None, leave=False) as bar:
            trajectory, ledger = _watched(environment, controller, options.duration, bar)
        description = _describe(options, true, nominal, controller, environment, trajectory)
        description["disturbances"] = ledger
        runs.write_run(folder, trajectory, description)
        _record(folder, trajectory, true, description)
        elapsed = time.perf_counter() - started
    _print_summary(trajectory, description, elapsed)
    print(f"wrote {out}/  ({runs.RECORDING}, {runs.ARRAYS}, {runs.DESCRIPTION})")
    if trajectory.status == "diverged":
        print(f"octarm: the run {trajectory.message}; it was kept up to there", file=sys.stderr)
        return ExitCode.DIVERGED
    if options.view:
        return _view(out)
    print(f"see it: octarm replay {shlex.quote(str(out))}")
    return ExitCode.FINE


def _watched(
    environment: control.Environment, controller: Controller, duration: float, bar: tqdm
) -> tuple[Trajectory, list[dict[str, Any]]]:
    """The run, and the ledger of its disturbances."""
    task, physics = environment.task, environment.physics
    if not task.disturbances:
        return rollout(environment, controller, duration, progress=bar.update), []
    ledger = Ledger(task.disturbances, physics)
    physics.watch = ledger.step

    def progress() -> None:
        ledger.instant(physics)
        bar.update()

    trajectory = rollout(environment, controller, duration, progress=progress)
    return trajectory, ledger.rows()


def replay(options: Replay) -> int:
    """`octarm replay`: the viewer on a recorded run, or a picture of it."""
    from octarm import viewer

    runs.read_description(options.run)  # raises when this is no run
    recording = options.run / runs.RECORDING
    if not recording.is_file():
        raise ValueError(f"{options.run} has no recording {runs.RECORDING}")
    if options.screenshot is None:
        viewer.open_viewer([recording])
        return ExitCode.FINE
    trajectory, _ = runs.read_run(options.run)
    end = float(trajectory.t[-1])
    shown = 0.5 * end if options.time is None else options.time
    if not 0.0 <= shown <= end:
        raise ValueError(f"time is {shown:g} s; the run goes from 0 to {end:g} s")
    if options.screenshot.suffix != ".png":
        raise ValueError(f"screenshot is {str(options.screenshot)!r}; its name must end in .png")
    viewer.screenshot(recording, options.screenshot, time=shown)
    print(f"wrote {options.screenshot}")
    return ExitCode.FINE


def validate(options: Validate) -> int:
    """`octarm validate`: MuJoCo against the analytic model, or the controllers' Lyapunov ledger."""
    from controllers.ledger import ledger
    from octarm.validation import arm_with, random_arm
    from octarm.validation import validate as plant

    compare, states = (ledger, 3000) if options.controllers else (plant, 10_000)
    states = states if options.states is None else options.states
    if options.modules < 1 or options.random_parameters < 0 or states < 1:
        raise ValueError(
            f"modules is {options.modules}, states {states}, random parameters "
            f"{options.random_parameters}; they must be at least 1, 1 and 0"
        )
    if options.seed < 0:
        raise ValueError(f"seed is {options.seed}; it must be at least 0")
    if options.json is not None and not options.json.parent.is_dir():
        raise ValueError(f"{options.json} cannot be written: there is no folder for it")
    draw = np.random.default_rng(options.seed)
    arms = [random_arm(draw, options.modules) for _ in range(options.random_parameters)]
    reports = []
    for arm in arms or [arm_with(options.modules)]:
        with tqdm(bar_format="checking {desc}", disable=None, leave=False) as line:
            report = compare(arm, states, options.seed, line.set_description_str)
        print(report.format(), flush=True)
        reports.append(report)
    if options.json is not None:
        write_text(options.json, json.dumps([r.to_dict() for r in reports], indent=2) + "\n")
    return ExitCode.FINE if all(r.passed for r in reports) else ExitCode.CHECK_FAILED


def named_values(option: str, items: Sequence[str]) -> dict[str, npt.ArrayLike]:
    """Parses NAME:VALUES items; values are separated by `,`, rows by `;`.

    Raises:
        ValueError: if an item has no name, or its values are not numbers.
    """
    values = {}
    for item in items:
        name, _, text = item.partition(":")
        if name in values:
            raise ValueError(f"{option} gives {name} twice")
        try:
            rows = [[float(x) for x in row.split(",")] for row in text.split(";")]
            table = np.array(rows)
        except ValueError:
            raise ValueError(
                f"{option} is {item!r}; it must read NAME:NUMBER, NAME:A,B,C or NAME:A,B;C,D"
            ) from None
        if table.shape[0] == 1:
            table = table[0]
        values[name] = table[0] if table.shape == (1,) else table
    return values


def _gains(items: Sequence[str]) -> dict[str, npt.ArrayLike]:
    gains = named_values("--gain", items)
    for item, value in zip(items, gains.values(), strict=True):
        if np.ndim(value) > 1:
            raise ValueError(f"--gain is {item!r}; a gain is one number, or one a coordinate")
    return gains


def _true_parameters(options: Run) -> ArmParameters:
    changes = named_values("--parameter", options.parameter)
    known = [field.name for field in dataclasses.fields(ArmParameters)]
    for name in changes:
        if name not in known:
            raise ValueError(f"unknown parameter {name!r}{closest(name, known)}")
    return dataclasses.replace(nominal_parameters(), **changes)


def _describe(
    options: Run,
    true: ArmParameters,
    nominal: ArmParameters,
    controller: Controller,
    environment: control.Environment,
    trajectory: Trajectory,
) -> dict[str, Any]:
    """All that a run depends on, and what came of it: the content of run.json."""
    task: TrackingTask = environment.task
    return {
        "controller": {"name": options.controller, "gains": runs.gains_of(controller)},
        "parameters": true.to_dict(),
        "nominal": nominal.to_dict(),
        "reference": {"name": options.reference, **runs.describe_fields(task.reference)},
        "disturbances": [],
        "seed": options.seed,
        "duration": options.duration,
        "timestep": environment.physics.timestep(),
        "control_period": environment.control_timestep(),
        "actuation": options.actuation,
        "metrics": runs.measure(
            trajectory,
            control_period=environment.control_timestep(),
            input_limit=environment.physics.input_limit(),
            phi=getattr(controller, "phi", None),
        ),
        "status": trajectory.status,
        "message": trajectory.message,
        "versions": runs.versions(),
        "digest": trajectory.digest,
        "command": shlex.join(["octarm", *sys.argv[1:]]),
    }


def _record(
    folder: Path, trajectory: Trajectory, true: ArmParameters, description: dict[str, Any]
) -> None:
    from octarm.recording import write_recording

    title = f"{description['controller']['name']} on {description['reference']['name']}"
    notes = f"# {title}\n\n```\n{description['command']}\n```\n\n" + _notes(description)
    known = ("seed", "duration", "timestep", "control_period", "status", "digest", "command")
    properties = {name: description[name] for name in ("controller", *known)}
    write_recording(
        folder / runs.RECORDING, trajectory, true, title=title, notes=notes, properties=properties
    )


def _notes(description: dict[str, Any]) -> str:
    """Gains, parameters and metrics as a page of text."""
    parts = []
    for heading, table in (
        ("Gains", description["controller"]["gains"]),
        ("True parameters", description["parameters"]),
        ("Nominal parameters", description["nominal"]),
        ("Metrics", description["metrics"]),
    ):
        rows = "\n".join(f"| {name} | {value} |" for name, value in table.items())
        parts.append(f"## {heading}\n\n| | |\n|---|---|\n{rows}\n")
    return "\n".join(parts)


def _view(folder: Path) -> int:
    """Opens the viewer on a fresh run; without a display the run is still fine."""
    from octarm import viewer

    try:
        viewer.open_viewer([folder / runs.RECORDING])
    except RuntimeError as error:
        print(f"the viewer did not open: {error}")
        print(f"a picture: octarm replay {shlex.quote(str(folder))} --screenshot picture.png")
    return ExitCode.FINE


def _dated_folder(controller: str) -> Path:
    now = datetime.datetime.now().strftime("%Y%m%d-%H%M%S.%f")[:-3]
    base = Path("runs") / f"{now}-{controller}"
    names = itertools.chain([base], (Path(f"{base}-{i}") for i in itertools.count(2)))
    return next(name for name in names if not name.exists())


def _print_summary(trajectory: Trajectory, description: dict[str, Any], elapsed: float) -> None:
    simulated = len(trajectory) * description["control_period"]
    print(
        f"{description['controller']['name']} on {description['reference']['name']}: "
        f"{simulated:g} s at {1.0 / description['control_period']:g} Hz, done in {elapsed:.1f} s"
    )
    for line in in_words(description["disturbances"]):
        print(f"  {line}")
    rms, peak = description["metrics"]["rms_error"], description["metrics"]["peak_error"]
    if None in rms:
        return
    amplitude = 0.5 * np.ptp(trajectory.q_d, axis=0)
    print(f"  error after {SETTLED_AFTER:g} s        rms       peak   rms / amplitude")
    for j, name in enumerate(coordinate_names(len(rms) // 2)):
        unit = "m  " if j < len(rms) // 2 else "rad"
        share = f"{100.0 * rms[j] / amplitude[j]:10.3f} %" if amplitude[j] > 0.0 else ""
        print(f"  {name:>8} [{unit}]  {rms[j]:10.2e} {peak[j]:10.2e}  {share}".rstrip())

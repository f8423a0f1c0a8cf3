"""What the commands do."""

from __future__ import annotations

import dataclasses
import datetime
import functools
import itertools
import json
import shlex
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from dm_control.rl import control
from tqdm import tqdm

from controllers import make_controller
from octarm.arm.mjcf import nominal_parameters, template_model
from octarm.arm.parameters import ArmParameters
from octarm.commands.summary import Swing, summary
from octarm.disturbances.spelling import parse_disturbance
from octarm.errors import ExitCode, OctarmError, closest
from octarm.files import write_text
from octarm.runs import folder as runs
from octarm.runs.experiment import Experiment, run_into
from octarm.simulation.environment import whole_periods

if TYPE_CHECKING:
    from octarm.checks.report import Report
    from octarm.options.checks import Validate
    from octarm.options.run import Run


def run(options: Run) -> int:
    """`octarm run`: one controller against the arm, as a run folder."""
    from octarm.recordings.recording import run_recording  # the import takes half a second

    true = _true_parameters(options)
    nominal = true.mismatched(options.mismatch).scaled(**named_values("--nominal", options.nominal))
    experiment = Experiment(
        controller=options.controller,
        gains=_gains(options.gain),
        nominal=nominal,
        parameters=true,
        reference=options.reference,
        disturbances=tuple(parse_disturbance(text) for text in options.disturbance),
        seed=options.seed,
        duration=options.duration,
        timestep=options.timestep,
        control_period=options.control_period,
        actuation=options.actuation,
    )
    factory = functools.partial(make_controller, gain_set=options.gains)
    environment, controller = experiment.begin(factory)
    announced = experiment.announcement(environment, controller)
    periods = whole_periods(options.duration, environment.control_timestep())
    out = options.out or _dated_folder(options.controller)
    started, swing = time.perf_counter(), Swing()
    with tqdm(total=periods, unit=" periods", disable=None, leave=False) as bar:
        trajectory, description = run_into(
            out, environment, controller, announced, recording=run_recording, progress=bar.update,
            keep=swing.add,
        )  # fmt: skip
    elapsed = time.perf_counter() - started
    print(summary(len(trajectory), swing.amplitude(), description, elapsed))
    print(f"wrote {out}/  ({runs.RECORDING}, {runs.ARRAYS}, {runs.DESCRIPTION})")
    if trajectory.status == "interrupted":
        raise KeyboardInterrupt(f"{out} holds the run up to t = {trajectory.t[-1]:.6g} s")
    if trajectory.status == "diverged":
        told = f"the run {trajectory.message}; it was kept up to there"
        print(f"octarm: {told}{_advice(options, environment)}", file=sys.stderr)
        return ExitCode.DIVERGED
    if options.view:
        return _view(out)
    print(f"see it: octarm replay {shlex.quote(str(out))}")
    return ExitCode.FINE


def _advice(options: Run, environment: control.Environment) -> str:
    """What may help a run that diverged: tuned gains are high for the usual control period."""
    usual = float(template_model().opt.timestep)
    if options.gains in (None, "tuned") and environment.control_timestep() > 1.5 * usual:
        return (
            f"; the tuned gains are for a control period of {usual:g} s, --gains recommended "
            "bear longer ones"
        )
    return ""


def validate(options: Validate) -> int:
    """`octarm validate`: MuJoCo against the analytic model, or the controllers' Lyapunov ledger."""
    from controllers.proofs.ledger import ledger
    from octarm.checks.validation import arm_with, random_arm
    from octarm.checks.validation import validate as plant

    compare, states = (ledger, 3000) if options.controllers else (plant, 10_000)
    states = states if options.states is None else options.states
    if options.modules < 1 or options.random_parameters < 0 or states < 1:
        raise OctarmError(
            f"modules is {options.modules}, states {states}, random parameters "
            f"{options.random_parameters}; they must be at least 1, 1 and 0"
        )
    if options.seed < 0:
        raise OctarmError(f"seed is {options.seed}; it must be at least 0")
    if options.json is not None and not options.json.parent.is_dir():
        raise OctarmError(f"{options.json} cannot be written: there is no folder for it")
    draw = np.random.default_rng(options.seed)
    arms = [random_arm(draw, options.modules) for _ in range(options.random_parameters)]
    reports: list[Report] = []
    for arm in arms or [arm_with(options.modules)]:
        with tqdm(bar_format="checking {desc}", disable=None, leave=False) as line:
            report = compare(arm, states, options.seed, line.set_description_str)
        print(report.format(), flush=True)
        reports.append(report)
    if options.json is not None:
        write_text(options.json, json.dumps([r.to_dict() for r in reports], indent=2) + "\n")
    return ExitCode.FINE if all(r.passed for r in reports) else ExitCode.CHECK_FAILED


def named_values(option: str, items: Sequence[str]) -> dict[str, npt.ArrayLike]:
    """Parses NAME:VALUES items to numbers or arrays of shape (k,) or (rows, k).

    Values are separated by `,`, rows by `;`.

    Raises:
        ValueError: if an item has no name, or its values are not numbers.
    """
    values: dict[str, npt.ArrayLike] = {}
    for item in items:
        name, _, text = item.partition(":")
        if name in values:
            raise OctarmError(f"{option} gives {name} twice")
        try:
            rows = [[float(x) for x in row.split(",")] for row in text.split(";")]
            table = np.array(rows)
        except ValueError:
            raise OctarmError(
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
            raise OctarmError(f"--gain is {item!r}; a gain is one number, or one a coordinate")
    return gains


def _true_parameters(options: Run) -> ArmParameters:
    changes = named_values("--parameter", options.parameter)
    known = [field.name for field in dataclasses.fields(ArmParameters)]
    for name in changes:
        if name not in known:
            raise OctarmError(f"unknown parameter {name!r}{closest(name, known)}")
    return dataclasses.replace(nominal_parameters(), **changes)


def _view(folder: Path) -> int:
    """Opens the viewer on a fresh run; without a display the run is still fine."""
    from octarm.recordings import viewer

    try:
        viewer.open_viewer([folder / runs.RECORDING])
    except OctarmError as error:
        print(f"the viewer did not open: {error}")
        print(f"a picture: octarm replay {shlex.quote(str(folder))} --screenshot picture.png")
    return ExitCode.FINE


def _dated_folder(controller: str) -> Path:
    now = datetime.datetime.now().strftime("%Y%m%d-%H%M%S.%f")[:-3]
    base = Path("runs") / f"{now}-{controller}"
    names = itertools.chain([base], (Path(f"{base}-{i}") for i in itertools.count(2)))
    return next(name for name in names if not name.exists())

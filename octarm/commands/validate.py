"""What `octarm validate` does."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from controllers import CONTROLLERS, make_controller
from controllers.proofs.ledger import ledger
from octarm.arm.file import read_arm
from octarm.arm.lagrange import equilibrium
from octarm.arm.modes import rates
from octarm.arm.parameters import ArmParameters
from octarm.arm.rod import LAYOUTS
from octarm.bars import bar as new_bar
from octarm.checks import rod_study
from octarm.checks.closed_loops import compare_engines
from octarm.checks.rod_convergence import MODULES, Study, study
from octarm.checks.validation import arm_with, random_arm
from octarm.checks.validation import validate as plant
from octarm.commands.checks import ValidateOptions
from octarm.errors import ExitCode, printable
from octarm.files import write_files, write_text
from octarm.reports.arm_figures import rod_figures
from octarm.tolerances import CheckTable

SWITCHING = ("smc", "super-twisting")  # laws with sgn(s)
# The cases and motions of --rod that are drawn, the motions with their styles.
_DRAWN = (
    "small tip load", "tip at 1 rad", "weight across", "weight across, tapered",
    "bending frequency 1", "bending frequency 2", "axial frequency 1", "release, tip in 1 s",
)  # fmt: skip
_CHAINS = {
    "rod": "rod",
    "paper, N = 3": "first, coarse", "centred, N = 3": "second, coarse",
    "paper, N = 10": "first", "centred, N = 10": "second",
}  # fmt: skip
_PEERS = {
    "rod": "rod",
    "PyElastica, n = 20": "first",
    "the same chain, N = 20": "dots",
    "PyElastica, extrapolated": "second",
}

Check = Callable[[Callable[[str], None]], CheckTable]


def validate(options: ValidateOptions) -> int:
    """`octarm validate`: MuJoCo and the analytic model, or another of the checks."""
    reports: list[dict[str, Any]] = []
    result: Study | CheckTable
    for check in [study] if options.rod else _checks(options):
        with new_bar(bar_format="checking {desc}") as line:
            result = check(line.set_description_str)
        print(result, flush=True)
        reports.append(result.to_dict())
        if options.out is not None and isinstance(result, Study):
            _draw(options.out, result)
            print(f"wrote {printable(str(options.out))}")
    if options.json is not None:
        write_text(options.json, json.dumps(reports, indent=2) + "\n")
    return ExitCode.FINE if all(r["passed"] for r in reports) else ExitCode.CHECK_FAILED


def _checks(options: ValidateOptions) -> Iterator[Check]:
    """A check for each arm: that of a file, random ones, or the nominal one with N modules."""
    draws = np.random.default_rng(options.seed)
    arms = [random_arm(draws, options.modules) for _ in range(options.random_parameters)]
    if options.arm is not None:
        arms = [read_arm(options.arm)]
    for arm in arms or [arm_with(options.modules)]:
        if options.engines:
            yield partial(_engines, options, arm)
        elif options.controllers:
            yield partial(ledger, arm, options.states or 3000, options.seed)
        else:
            yield partial(plant, arm, options.states or 10_000, options.seed)


def _engines(
    options: ValidateOptions, arm: ArmParameters, progress: Callable[[str], None]
) -> CheckTable:
    """Both engines in closed loop; on a finer plant for 1 s, with forces that are rolled off."""
    make, duration = make_controller, 10.0
    if options.plant_modules is not None:
        fastest = np.max(np.abs(np.imag(rates(arm, equilibrium(arm))))) / (2.0 * np.pi)
        make, duration = partial(make_controller, gains={"roll_off": 4.0 * fastest}), 1.0
    return compare_engines(
        arm,
        make,
        [*CONTROLLERS],
        SWITCHING,
        plant_modules=options.plant_modules,
        layout=options.layout,
        duration=duration,
        seed=options.seed,
        progress=progress,
    )


def _draw(out: Path, result: Study) -> None:
    """Writes the figures of a convergence study into a folder, all or none."""
    errors: dict[str, dict[str, np.ndarray]] = {case: {} for case in _DRAWN}
    for curve in result.curves:
        if curve.case in errors and curve.layout in LAYOUTS:
            errors[curve.case][curve.layout] = curve.errors
    motions = [("the default rod", result.motions, _CHAINS)]
    if result.peer:
        motions.append(("a slim rod, beside PyElastica", result.peer, _PEERS))
    panels = [
        (title, {name: (tips[name], style) for name, style in drawn.items()})
        for title, tips, drawn in motions
    ]
    files: dict[Path, bytes] = {}
    for picture in rod_figures(MODULES, errors, panels, rod_study.DURATION):
        files |= picture.files(out)
    write_files(files)

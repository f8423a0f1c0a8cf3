"""What `octarm validate` does."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from controllers import CONTROLLERS, make_controller
from controllers.proofs.ledger import ledger as ledger
from octarm.arm.file import read_arm
from octarm.arm.groups import PAPER
from octarm.arm.lagrange import equilibrium
from octarm.arm.modes import rates
from octarm.arm.parameters import ArmParameters
from octarm.bars import bar as new_bar
from octarm.checks.closed_loops import compare_engines
from octarm.checks.validation import arm_with, random_arm
from octarm.checks.validation import validate as plant
from octarm.errors import ExitCode
from octarm.files import write_text
from octarm.tolerances import CheckTable

SWITCHING = ("smc", "super-twisting")  # laws with sgn(s)

Compare = Callable[[ArmParameters, int, int, Callable[[str], None]], CheckTable]

__all__ = ["arms", "engines", "ledger", "plant", "validate"]


def engines(
    arm: ArmParameters,
    states: int,
    seed: int,
    progress: Callable[[str], None],
    *,
    plant_modules: int | None = None,
    layout: str = PAPER,
) -> CheckTable:
    """Both engines in closed loop, with every controller.

    On a plant of more modules for a second, their forces rolled off at four times the frequency of
    the model's fastest mode: loops that rattle would make something of every rounding error.
    """
    del states  # there are none to draw
    make, duration = make_controller, 10.0
    if plant_modules is not None:
        fastest = np.max(np.abs(np.imag(rates(arm, equilibrium(arm))))) / (2.0 * np.pi)
        make, duration = partial(make_controller, gains={"roll_off": 4.0 * fastest}), 1.0
    plant: dict[str, Any] = {"plant_modules": plant_modules, "layout": layout}
    plant |= {"duration": duration, "seed": seed, "progress": progress}
    return compare_engines(arm, make, [*CONTROLLERS], SWITCHING, **plant)


def arms(file: str | None, modules: int, random_arms: int, seed: int) -> list[ArmParameters]:
    """The arms to check: that of a file, random ones, or the nominal one with N modules."""
    if file is not None:
        return [read_arm(file)]
    draw = np.random.default_rng(seed)
    return [random_arm(draw, modules) for _ in range(random_arms)] or [arm_with(modules)]


def validate(
    compare: Compare, arms: Sequence[ArmParameters], states: int, seed: int, file: Path | None
) -> int:
    """`octarm validate`: MuJoCo and the analytic model, or the controllers' Lyapunov ledger."""
    reports: list[CheckTable] = []
    for arm in arms:
        with new_bar(bar_format="checking {desc}") as line:
            reports.append(compare(arm, states, seed, line.set_description_str))
        print(reports[-1], flush=True)
    if file is not None:
        write_text(file, json.dumps([r.to_dict() for r in reports], indent=2) + "\n")
    return ExitCode.FINE if all(r.passed for r in reports) else ExitCode.CHECK_FAILED

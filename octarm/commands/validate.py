"""What `octarm validate` does."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
from tqdm import tqdm

from controllers.proofs.ledger import ledger as ledger
from octarm.arm.parameters import ArmParameters
from octarm.checks.report import Report
from octarm.checks.validation import arm_with, random_arm
from octarm.checks.validation import validate as plant
from octarm.errors import ExitCode
from octarm.files import write_text

Compare = Callable[[ArmParameters, int, int, Callable[[str], None]], Report]

__all__ = ["ledger", "plant", "validate"]


def validate(
    compare: Compare, modules: int, random_arms: int, states: int, seed: int, file: Path | None
) -> int:
    """`octarm validate`: MuJoCo against the analytic model, or the controllers' Lyapunov ledger."""
    draw = np.random.default_rng(seed)
    arms = [random_arm(draw, modules) for _ in range(random_arms)] or [arm_with(modules)]
    reports: list[Report] = []
    for arm in arms:
        with tqdm(bar_format="checking {desc}", disable=None, leave=False) as line:
            reports.append(compare(arm, states, seed, line.set_description_str))
        print(reports[-1].format(), flush=True)
    if file is not None:
        write_text(file, json.dumps([r.to_dict() for r in reports], indent=2) + "\n")
    return ExitCode.FINE if all(r.passed for r in reports) else ExitCode.CHECK_FAILED

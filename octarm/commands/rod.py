"""What `octarm validate --rod` does."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from octarm.arm.rod import LAYOUTS
from octarm.bars import bar as new_bar
from octarm.checks.rod_convergence import MODULES, Study
from octarm.checks.rod_convergence import study as study
from octarm.errors import ExitCode, printable
from octarm.files import write_files, write_text
from octarm.reports.convergence import picture

_DRAWN = (
    "small tip load", "tip at 1 rad", "weight across", "weight across, tapered",
    "bending frequency 1", "bending frequency 2", "axial frequency 1", "release, tip in 1 s",
)  # fmt: skip


def validate_rod(out: Path | None, file: Path | None) -> int:
    """`octarm validate --rod`: chains of modules against their rod; a figure and JSON, too."""
    with new_bar(bar_format="checking {desc}") as line:
        result = study(line.set_description_str)
    print(result, flush=True)
    if file is not None:
        write_text(file, json.dumps([result.to_dict()], indent=2) + "\n")
    if out is not None:
        _draw(out, result)
        print(f"wrote {printable(str(out))}")
    return ExitCode.FINE if result.table.passed else ExitCode.CHECK_FAILED


def _draw(out: Path, result: Study) -> None:
    """Writes the figure in both formats."""
    errors: dict[str, dict[str, np.ndarray]] = {case: {} for case in _DRAWN}
    for curve in result.curves:
        if curve.case in errors and curve.layout in LAYOUTS:
            errors[curve.case][curve.layout] = curve.errors
    write_files(picture(MODULES, errors).files(out))

"""What `octarm validate --rod` does."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from octarm.arm.rod import LAYOUTS
from octarm.bars import bar as new_bar
from octarm.checks import rod_motion
from octarm.checks.rod_convergence import MODULES, Study
from octarm.checks.rod_convergence import study as study
from octarm.errors import ExitCode, printable
from octarm.files import write_files, write_text
from octarm.reports.convergence import pictures

_DRAWN = (
    "small tip load", "tip at 1 rad", "weight across", "weight across, tapered",
    "bending frequency 1", "bending frequency 2", "axial frequency 1", "release, tip in 1 s",
)  # fmt: skip
# What is drawn of the motions, and in which style.
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


def validate_rod(out: Path | None, file: Path | None) -> int:
    """`octarm validate --rod`: chains of modules against their rod; figures and JSON, too."""
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
    """Writes the figures, all or none."""
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
    for picture in pictures(MODULES, errors, panels, rod_motion.DURATION):
        files |= picture.files(out)
    write_files(files)

"""The figures of `octarm validate --rod`."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from octarm.arm.rod import LAYOUTS
from octarm.checks import rod_study
from octarm.checks.rod_convergence import MODULES, Study
from octarm.files import write_files
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


def draw(out: Path, result: Study) -> None:
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
    for picture in pictures(MODULES, errors, panels, rod_study.DURATION):
        files |= picture.files(out)
    write_files(files)

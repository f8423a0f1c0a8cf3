"""Quantities of cells as tables and figures show them, in percent."""

from __future__ import annotations

import numpy as np

from octarm.reports.statistics import Interval
from paper.evidence import Evidence
from paper.measured import Cell, interval
from paper.studies import BENDS, MODELS


def error_of(evidence: Evidence, cell: Cell) -> Interval:
    """Error of a cell [% of the motion]."""
    return scaled(evidence.measured.median(cell, "error"), 100.0)


def chattering_of(evidence: Evidence, cell: Cell) -> Interval:
    """Chattering of a cell [% of the weight]."""
    return scaled(evidence.measured.median(cell, "chattering"), 100.0)


def error_mean(evidence: Evidence, label: str, noise: float, reference: str = BENDS) -> Interval:
    """Error of a variant, mean over the nominal models, in percent; seed by seed."""
    own = [Cell(label, reference=reference, mismatch=m, noise=noise) for m in MODELS]
    values = [evidence.measured.values(cell, "error") for cell in own]
    return interval(100.0 * np.mean(values, axis=0))


def scaled(value: Interval, factor: float) -> Interval:
    """An interval times a factor."""
    return Interval(*(factor * float(x) for x in value))

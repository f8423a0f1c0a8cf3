"""The numbers of a sweep's report, which a notebook shows."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from octarm.html import notebook_cell
from octarm.reports.comparisons import Comparisons, compare
from octarm.reports.consistency import Remark, remarks
from octarm.reports.frame import read_episodes
from octarm.reports.page import Tables


class Report(NamedTuple):
    """What a report is made of.

    Attributes:
        name: of the sweep.
        comparisons: medians, failures, and paired differences from a baseline.
        remarks: what a reader should know, warnings first.
    """

    name: str
    comparisons: Comparisons
    remarks: Sequence[Remark]

    def _repr_html_(self) -> str:
        """What a notebook shows of it: the whole sweep at a glance."""
        lines = [f"{'Warning: ' * each.warning}{each.text}" for each in self.remarks]
        lines.append("Medians, and their 95 % intervals or ranges below; the best ones are bold.")
        table = Tables(self.comparisons).medians(None)
        return notebook_cell(f"Report on {self.name}", lines, table)


def report(sweep: str | Path, baseline: str | None = None, metrics: Sequence[str] = ()) -> Report:
    """The report on a sweep, as `octarm report` writes it.

    Given are the folder of the sweep, the controller that others are compared with, or its
    MODULE:NAME or FILE.py:NAME, the spec's first one if None, and names of metrics, or of columns
    of the sweep's table, the usual ones if empty. Raises OctarmError if it is no sweep, has no
    finished episode, or a name is unknown.
    """
    folder = Path(sweep)
    episodes = read_episodes(folder, metrics)
    names = {each.path: name for name, each in episodes.spec.code.items()}
    called = None if baseline is None else names.get(baseline, baseline)
    return Report(folder.resolve().name, compare(episodes, called), remarks(episodes))

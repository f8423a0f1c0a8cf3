"""All that claims, tables and figures take their numbers from."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from pathlib import Path

from paper import jobs, series
from paper.effort import Effort
from paper.load import Cost
from paper.measured import Cell, Measured, measure
from paper.series import Series
from paper.stability import Outcome
from paper.studies import parts
from paper.variants import Cast


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Evidence:
    """What was run and measured.

    Attributes:
        cast: who ran.
        effort: how much.
        measured: all episodes.
        series: runs over time, by name.
        outcomes: how Lyapunov functions went.
        costs: of a step, by label.
    """

    cast: Cast
    effort: Effort
    measured: Measured
    series: Mapping[str, Series]
    outcomes: Sequence[Outcome]
    costs: Mapping[str, Cost]

    @functools.cached_property
    def seeds(self) -> int:
        """In each cell with noise."""
        return self.effort.seeds

    def known(self, cells: Sequence[Cell]) -> list[Cell]:
        """Those of the cells that were run."""
        return [cell for cell in cells if self.measured.has(cell)]


def gather(cast: Cast, effort: Effort, out: Path, costs: Sequence[Cost]) -> Evidence:
    """Reads what `paper.jobs.run_all` left in a folder.

    Raises:
        ValueError: if something is missing.
    """
    names = [request.name for request in series.requests(cast, effort)]
    return Evidence(
        cast=cast,
        effort=effort,
        measured=measure(parts(cast, effort), out / jobs.SWEEPS),
        series={name: series.read(jobs.series_file(out, name)) for name in names},
        outcomes=list(jobs.outcomes(cast, effort, out)),
        costs={cost.label: cost for cost in costs},
    )

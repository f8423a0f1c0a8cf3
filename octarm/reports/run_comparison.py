"""The page on several runs: in what they differ, their metrics, and their errors over time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from octarm.html import Cell, Table, templates
from octarm.metrics.metric import Metric
from octarm.metrics.table import code_of, declared_metrics
from octarm.palette import OTHERS, look_of
from octarm.recordings.channels import coordinates_of
from octarm.recordings.comparison import Compared, difference
from octarm.recordings.words import events_of
from octarm.reports import figures
from octarm.reports.figures import Picture
from octarm.reports.frame import DEFAULT
from octarm.reports.report import number
from octarm.reports.run_figures import thinned
from octarm.runs.folder import Run

_POINTS = 1200  # of a curve at most
_LARGEST = 1e6  # number that is drawn of an arm that diverged

# A curve: the number of its run, its instants (T,) [s], and its values (T, 2N).
_Curve = tuple[int, np.ndarray, np.ndarray]


class RunComparison(Compared):
    """Two or more runs of arms with as many modules each, next to each other.

    Attributes:
        colors: of the runs: those of their controllers, if these tell them apart.
    """

    def __init__(self, runs: Sequence[Run]) -> None:
        self._runs = runs
        self._descriptions = [description for _, description in runs]
        super().__init__(self._descriptions)
        self._coordinates = coordinates_of(self._descriptions[0])
        events = [event for each in self._descriptions for event in events_of(each)]
        self._begins = sorted({at for at, _, text in events if text and at > 0.0})
        laws = [str(each.get("controller", {}).get("name")) for each in self._descriptions]
        self.colors = [look_of(law).color for law in laws]
        if len({*self.colors}) < len(runs):
            self.colors = [OTHERS[i % len(OTHERS)] for i in range(len(runs))]

    def page(self, folders: Sequence[str], pictures: Sequence[Picture]) -> str:
        """The page as text, given the names of the runs' folders and its figures."""
        numbers = dict(self._numbers())
        main = [row for name in DEFAULT for row in numbers.pop(name, [])]
        others = [row for rows in numbers.values() for row in rows]
        head = [Cell("metric", kind="left"), Cell("of", kind="left"), *map(Cell, self.names)]
        template = templates().get_template("comparison.html")
        return template.render(
            comparison=self,
            differing=self._differing(folders),
            numbers=Table(head, main),
            others=Table(head, others),
            pictures=pictures,
        )

    def _differing(self, folders: Sequence[str]) -> Table:
        runs = zip(self.names, self.titles, self.colors, strict=True)
        head = [Cell(name, [title], "left", color) for name, title, color in runs]
        rows: list[list[Cell]] = []
        for name, values, of_the_task in [("folder", folders, False), *self.differences]:
            kind = "left task" if of_the_task else "left"
            rows.append([Cell(name, kind=kind), *(Cell(x, kind="wide") for x in values)])
        return Table([Cell("", kind="left"), *head], rows)

    def _numbers(self) -> Iterator[tuple[str, list[list[Cell]]]]:
        known: dict[str, Metric] = {}
        for description in self._descriptions:
            known |= declared_metrics(code_of(description))
        for name in dict.fromkeys(name for each in self._descriptions for name in each["metrics"]):
            if name in known:
                yield name, list(self._rows(name, known[name]))

    def ranking(self) -> Iterator[str]:
        """Which run is the best in each metric, a line each; none where runs are not ranked.

        Of a metric with several numbers, such as one a coordinate, in how many of them.
        """
        for name, rows in self._numbers() if self.ranked else ():
            best = [[cell.kind == "best" for cell in row[2:]] for row in rows]
            told = [row for row in best if any(row) and not all(row)]
            counts = zip(self.names, map(sum, zip(*told, strict=True)), strict=False)
            words = [
                f"{run} is best" + (f" in {count} of {len(rows)}" if len(rows) > 1 else "")
                for run, count in counts
                if count
            ]
            if words or any(map(any, best)):
                yield f"{name.replace('_', ' ')}: {', '.join(words) or 'alike'}"

    def _rows(self, name: str, metric: Metric) -> Iterator[list[Cell]]:
        of, groups = [""], {"": slice(None)}
        if metric.of == "coordinate":
            of, groups = self._coordinates.names, self._coordinates.groups
        elif metric.of == "input":
            of = self._coordinates.inputs
        columns = np.array([_column(x["metrics"].get(name), len(of)) for x in self._descriptions])
        for part in sorted(groups.values(), key=lambda part: part.start or 0):  # with one unit
            sizes = np.abs(columns[:, part][np.isfinite(columns[:, part])])
            unit = metric.unit_for(self._coordinates.units[part][0])
            small = unit in ("m", "rad", "N", "N m") and sizes.size and sizes.max() < 1.0
            factor, unit = (1e3, f"m{unit}") if small else (1.0, "" if unit == "1" else unit)
            title = name.replace("_", " ") + (f" [{unit}]" if unit else "")
            for label, values in zip(of[part], columns[:, part].T, strict=True):
                if np.isfinite(values).any():  # not the overshoot of what does not move
                    order = np.abs(values) if metric.zero_best else metric.sign * values
                    best = np.nanmin(order) if metric.sign and self.ranked else math.nan
                    cells = [
                        Cell(number(factor * float(value)), kind="best" if rank == best else "")
                        for value, rank in zip(values, order, strict=True)
                    ]
                    yield [Cell(title, kind="left"), Cell(label, kind="left"), *cells]

    def pictures(self) -> Iterator[Picture]:
        """Errors, how they differ from those of the first run, and input forces, over time."""
        names, first = self._coordinates.names, self._runs[0].trajectory
        with figures.figure_style():
            errors = [(i, run.t, run.error) for i, (run, _) in enumerate(self._runs)]
            yield self._picture("errors", "error", "Error q - q_d.", errors, names)
            larger = [(i, *difference(first, run)) for i, (run, _) in enumerate(self._runs) if i]
            words = "above 0 the other one is nearer" if self.ranked else "they are not ranked"
            text = f"|error| of A less that of each other run: {words}."
            yield self._picture("differences", "difference", text, larger, names)
            inputs = [(i, run.t, run.tau) for i, (run, _) in enumerate(self._runs)]
            yield self._picture("inputs", "", "Input forces.", inputs, self._coordinates.inputs)

    def _picture(
        self, name: str, what: str, caption: str, curves: Sequence[_Curve], of: Sequence[str]
    ) -> Picture:
        """A panel for each coordinate or input, a line for each run."""
        figure, panels = figures.panels_of(len(of), 1.75, sharex=True)
        fine = [i for i, (_, each) in enumerate(self._runs) if each.get("status") != "diverged"]
        for j, (part, ax) in enumerate(zip(of, panels, strict=True)):
            factor, unit = (1e3, f"m{self._coordinates.units[j]}") if what else (1.0, "N")
            ends: list[float] = []
            for i, t, values in curves:
                y = factor * np.where(np.abs(values[:, j]) < _LARGEST, values[:, j], np.nan)
                look = {"color": self.colors[i], "label": f"{self.names[i]}: {self.titles[i]}"}
                ax.plot(*thinned(t, y, _POINTS), linewidth=0.9, **look)
                ends += [float(y.min()), float(y.max())] if i in fine else []
            ax.set_title(f"{part} {what}".strip() + f" [{unit}]")
            for at in self._begins:
                ax.axvline(at, color=figures.INK, linewidth=1.0, linestyle="--")
            if ends:
                room = 0.06 * (max(ends) - min(ends)) or 1.0
                ax.set_ylim(min(ends) - room, max(ends) + room)
        figures.name_axes(panels, "time [s]")
        figures.add_legend(figure, panels[0])
        if self._begins:
            caption += " Dashed: when a disturbance begins."
        if len(fine) < len(self._runs):
            caption += " Runs that diverged leave the panels."
        return figures.save_figure(name, caption, figure)


def _column(value: Any, count: int) -> np.ndarray:
    """The numbers of a metric, shape (count,); NaN where there is none."""
    numbers = np.array(value, dtype=float).ravel()  # None becomes NaN
    return numbers if len(numbers) == count else np.full(count, math.nan)

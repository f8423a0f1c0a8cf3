"""The page on several runs: in what they differ, their metrics, and their errors over time."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from typing import Any, cast

import numpy as np

from octarm.html import Cell, Table, templates
from octarm.metrics.declared import code_of, declared_metrics
from octarm.metrics.metric import Metric
from octarm.palette import OTHERS, look_of
from octarm.recordings.channels import coordinates_of
from octarm.recordings.comparison import difference
from octarm.recordings.titles import events_of
from octarm.recordings.what_differs import Compared
from octarm.reports import figures
from octarm.reports.figures import Axes, Picture
from octarm.reports.frame import DEFAULT
from octarm.reports.page import number
from octarm.reports.run_figures import thinned
from octarm.runs.folder import Run

_POINTS = 1200  # of a curve at most
_LARGEST = 1e6  # number that is drawn of an arm that diverged

# A curve: the number of its run, its instants (T,) [s], and its values (T, 2N).
_Curve = tuple[int, np.ndarray, np.ndarray]


class RunComparison(Compared):
    """Runs of arms with as many modules each, next to each other.

    Attributes:
        colors: of the runs: those of their controllers, if these tell them apart.
    """

    def __init__(self, runs: Sequence[Run]) -> None:
        """Compares these runs, two or more."""
        self._runs = runs
        self._descriptions = [description for _, description in runs]
        super().__init__(self._descriptions)
        self._coordinates = coordinates_of(self._descriptions[0])
        events = [event for each in self._descriptions for event in events_of(each)]
        self._begins = sorted({at for at, _, text in events if text and at > 0.0})
        laws = [str(each.get("controller", {}).get("name")) for each in self._descriptions]
        colors = [look_of(law).color for law in laws]
        apart = len({*colors}) == len(colors)  # then each has the colour of its controller
        self.colors = colors if apart else [OTHERS[i % len(OTHERS)] for i in range(len(runs))]

    def page(self, folders: Sequence[str], pictures: Sequence[Picture]) -> str:
        """The page as text, given the names of the runs' folders and its figures."""
        numbers = dict(self._numbers())
        main = [row for name in DEFAULT if name in numbers for row in numbers[name]]
        others = [row for name, rows in numbers.items() if name not in DEFAULT for row in rows]
        return (
            templates()
            .get_template("comparison.html")
            .render(
                comparison=self,
                differing=self._differing(folders),
                numbers=Table(self._head("metric", "of"), main),
                others=Table(self._head("metric", "of"), others),
                pictures=pictures,
            )
        )

    def _head(self, *words: str) -> list[Cell]:
        return [*(Cell(word, kind="left") for word in words), *map(Cell, self.names)]

    def _differing(self, folders: Sequence[str]) -> Table:
        """A row for each difference, below the titles of the runs."""
        head = [Cell("", kind="left")]
        for i, name in enumerate(self.names):
            head.append(Cell(name, [self.titles[i]], "left", self.colors[i]))
        rows = [[Cell("folder", kind="left"), *(Cell(name, kind="wide") for name in folders)]]
        for each in self.differences:
            kind = "left task" if each.of_the_task else "left"
            rows.append([Cell(each.name, kind=kind), *(Cell(x, kind="wide") for x in each.values)])
        return Table(head, rows)

    def _numbers(self) -> Iterator[tuple[str, list[list[Cell]]]]:
        """The rows of each metric that a run has."""
        known: dict[str, Metric] = {}
        for description in self._descriptions:
            known |= declared_metrics(code_of(description))
        names = dict.fromkeys(name for each in self._descriptions for name in each["metrics"])
        for name in names:
            if name in known:
                yield name, list(self._rows(name, known[name]))

    def ranking(self) -> Iterator[str]:
        """Which run is the best in each metric, a line each; none where runs are not ranked.

        Of a metric with several numbers, such as one a coordinate, in how many of them.
        """
        for name, rows in self._numbers() if self.ranked else ():
            best = [[x for x, cell in zip(self.names, row[2:], strict=True) if cell.kind == "best"]
                    for row in rows]  # fmt: skip
            told = [names for names in best if 0 < len(names) < len(self.names)]
            counts = {x: sum(x in names for names in told) for x in self.names}
            words = [
                f"{x} is best" + (f" in {n} of {len(rows)}" if len(rows) > 1 else "")
                for x, n in counts.items()
                if n
            ]
            if words or any(best):
                yield f"{name.replace('_', ' ')}: {', '.join(words) or 'alike'}"

    def _rows(self, name: str, metric: Metric) -> Iterator[list[Cell]]:
        """A row for each coordinate or input, or one for the arm."""
        of, units = self._coordinates.names, self._coordinates.units
        if metric.of != "coordinate":
            of, units = (self._coordinates.inputs if metric.of == "input" else [""]), [""] * len(of)
        columns = np.array([_column(x["metrics"].get(name), len(of)) for x in self._descriptions])
        finite = np.where(np.isfinite(columns), np.abs(columns), -np.inf).max(axis=0)
        for j, (part, coordinate_unit) in enumerate(zip(of, units, strict=False)):
            values = columns[:, j]
            if finite[j] < 0.0:  # such as the overshoot of what does not move
                continue
            # One unit for all coordinates of a kind.
            kinds = zip(finite, units, strict=False)
            largest = max(x for x, kind in kinds if kind == coordinate_unit)
            unit = metric.unit_for(coordinate_unit or "m")
            small = unit in ("m", "rad", "N", "N m") and largest < 1.0
            factor, unit = (1e3, f"m{unit}") if small else (1.0, "" if unit == "1" else unit)
            order = np.abs(values) if metric.zero_best else metric.sign * values
            best = np.nanmin(order) if metric.sign and self.ranked else math.nan
            title = name.replace("_", " ") + (f" [{unit}]" if unit else "")
            cells = [
                Cell(number(factor * value), kind="best" if rank == best else "")
                for value, rank in zip(values.tolist(), order.tolist(), strict=True)
            ]
            yield [Cell(title, kind="left"), Cell(part, kind="left"), *cells]

    def pictures(self) -> Iterator[Picture]:
        """Errors, how they differ from those of the first run, and input forces, over time."""
        with figures.figure_style():
            coordinates = self._coordinates
            errors = [(i, run.t, run.error) for i, (run, _) in enumerate(self._runs)]
            yield self._picture("errors", "error", "Error q - q_d.", errors, coordinates.names)
            first = self._runs[0].trajectory
            larger = [(i, *difference(first, run)) for i, (run, _) in enumerate(self._runs) if i]
            words = "above 0 the other one is nearer" if self.ranked else "they are not ranked"
            text = f"|error| of A less that of each other run: {words}."
            yield self._picture("differences", "difference", text, larger, coordinates.names)
            inputs = [(i, run.t, run.tau) for i, (run, _) in enumerate(self._runs)]
            yield self._picture("inputs", "", "Input forces.", inputs, coordinates.inputs)

    def _picture(
        self, name: str, what: str, caption: str, curves: Sequence[_Curve], of: Sequence[str]
    ) -> Picture:
        """A panel for each coordinate or input, a line for each run."""
        figure, panels = figures.panels_of(len(of), 1.75, sharex=True)
        fine = [i for i, (_, each) in enumerate(self._runs) if each.get("status") != "diverged"]
        for j, (part, ax) in enumerate(zip(of, panels, strict=True)):
            unit = self._coordinates.units[j] if what else "N"
            factor, unit = (1e3, f"m{unit}") if what else (1.0, unit)
            for i, t, values in curves:
                y = factor * np.where(np.abs(values[:, j]) < _LARGEST, values[:, j], np.nan)
                label = f"{self.names[i]}: {self.titles[i]}"
                color = self.colors[i]
                ax.plot(*thinned(t, y, _POINTS), color=color, linewidth=0.9, label=label)
            ax.set_title(f"{part} {what}".strip() + f" [{unit}]")
            for at in self._begins:
                ax.axvline(at, color=figures.INK, linewidth=1.0, linestyle="--")
            _limit(ax, [factor * x[:, j] for i, _, x in curves if i in fine])
        figures.name_axes(panels, "time [s]")
        figures.add_legend(figure, panels[0])
        if self._begins:
            caption += " Dashed: when a disturbance begins."
        if len(fine) < len(self._runs):
            caption += " Runs that diverged leave the panels."
        return figures.save_figure(name, caption, figure)


def _limit(ax: Axes, values: Sequence[np.ndarray]) -> None:
    """Lets the runs that did not diverge, each of shape (T,), fill a panel."""
    if values:
        low, high = min(float(x.min()) for x in values), max(float(x.max()) for x in values)
        room = 0.06 * (high - low) or 1.0
        ax.set_ylim(low - room, high + room)


def _column(value: Any, count: int) -> list[float]:
    """The numbers of a metric; NaN where there is none."""
    numbers = cast("list[Any]", value if isinstance(value, list) else [value])
    numbers = [math.nan if x is None else float(x) for x in numbers]
    return numbers if len(numbers) == count else [math.nan] * count

"""The table of metrics, and `Metrics`, which measures a run or a batch while it goes on.

No trajectory is held. Results do not depend on how the run is cut into blocks, and are the same
for an arm alone and as a row of a batch, bit for bit. Metrics of a user are given as MODULE:NAME or
FILE.py:NAME; see `octarm.declared`.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
import numpy.typing as npt

from octarm.arm.actuation import Actuation
from octarm.arrays import stacked
from octarm.declared import Code, Declared, lacking, word_of
from octarm.errors import OctarmError, closest, printable, quoted
from octarm.formats import Document
from octarm.interfaces import WITHIN, Rows
from octarm.metrics.forces import Chattering, ForceUse, InputUse
from octarm.metrics.metric import SETTLED_AFTER as SETTLED_AFTER
from octarm.metrics.metric import Accumulator, Metric, Settings, asked
from octarm.metrics.sliding import ReachingBound, Sliding
from octarm.metrics.tracking import Overshoot, Settling, TipError, TrackingError
from octarm.units import ANY, Range

_FIELDS = ("t", "q", "q_d", "tau", "force", "plant_tip")
_FORCES = ("tau", "force", "asked_tau", "asked_force")
_NUMBERS_A_PART = 50_000  # of a coordinate array; more at a time would leave the caches


class Catalogue(Mapping[str, Metric]):
    """The metrics by name, as accumulators declare them.

    Attributes:
        accumulators: the classes, in the order of their metrics.
    """

    def __init__(self, *accumulators: type[Accumulator]) -> None:
        self.accumulators = accumulators

    def __getitem__(self, name: str) -> Metric:
        return {n: m for each in self.accumulators for n, m in each.metrics.items()}[name]

    def __iter__(self) -> Iterator[str]:
        return (name for each in self.accumulators for name in each.metrics)

    def __len__(self) -> int:
        return sum(len(each.metrics) for each in self.accumulators)

    def extended(self, others: Iterable[type[Accumulator]]) -> Catalogue:
        """This one, and those metrics of other accumulators that it does not have."""
        new = [each for each in dict.fromkeys(others) if each not in self.accumulators]
        return Catalogue(*self.accumulators, *new)

    @property
    def fields(self) -> tuple[str, ...]:
        """Names of the fields of rows that are measured, signals included; for a recorder."""
        signals = [name for each in self.accumulators for name in each.signals]
        return (*_FIELDS, *WITHIN, *dict.fromkeys(signals))


METRICS = Catalogue(
    TrackingError, Overshoot, Settling, TipError, InputUse, asked(InputUse), ForceUse,
    asked(ForceUse), Chattering, asked(Chattering, "chattering"), Sliding, ReachingBound,
)  # fmt: skip


class Metrics:
    """All that is measured of a run or of a batch of runs; `METRICS` describes it.

    Metrics that need a signal are there only when the rows hold it (`layer_share` only with a
    boundary layer, too).
    """

    def __init__(
        self, *, actuation: Actuation | None = None, catalogue: Catalogue = METRICS, **settings: Any
    ) -> None:
        """Metrics of arms of any number and batch shape; further arguments are those of `Settings`.

        The actuation turns the inputs that the arm received into a generalised force. Without it,
        that is taken to be the one that was asked for. The catalogue says what is measured.
        """
        self._settings = Settings(**settings)
        self._actuation = actuation
        self._catalogue = catalogue
        self._accumulators: list[Accumulator] = []
        self._sum: np.ndarray | float = 0.0  # not finite where something was not

    def update(self, rows: Rows) -> None:
        """Takes the next control instants: `t`, `q`, `q_d`, `tau`, `force`, and signals.

        The fields of `octarm.interfaces.WITHIN` say what happened at the physics steps. Without
        them a control period is one step, and what was asked for arrived. The arms of a batch may
        share their q_d, of shape (k, 1, 2N) then. Raises OctarmError if a limit, the layer or the
        band does not fit the arms.
        """
        if len(rows["t"]) == 0:
            return
        rows = {name: rows[name] for name in self._catalogue.fields if name in rows}
        if not self._accumulators:
            self._begin(rows)
        received = rows["received"][:, 0] if "received" in rows else rows["tau"]
        instants, by_instant = {**rows, "received": received}, self._accumulators
        if self._settings.steps > 1:
            by_step = [each for each in self._accumulators if not each.signals]
            self._take(_within(rows, self._settings), by_step)
            by_instant = [each for each in self._accumulators if each.signals]
        self._take(instants, by_instant)

    def _begin(self, rows: Rows) -> None:
        steps = rows["received"].shape[1] if "received" in rows else 1
        self._settings = dataclasses.replace(self._settings, steps=steps)
        first = {name: array[0] for name, array in rows.items()}
        self._accumulators = [
            make(first, self._settings)
            for make in self._catalogue.accumulators
            if set(make.signals) <= set(rows)
        ]

    def _take(self, rows: Rows, accumulators: Sequence[Accumulator]) -> None:
        """Hands rows, whose `received` is that of one step, to accumulators, a few at a time."""
        most = max(1, _NUMBERS_A_PART // rows["q"][0].size)
        settled, count = int(np.searchsorted(rows["t"], self._settings.settle)), len(rows["t"])
        starts = [*range(0, settled, most), *range(settled, count, most)]
        with np.errstate(all="ignore"):  # a diverged arm may hold anything
            for start, end in itertools.pairwise([*starts, count]):
                part = self._complete({k: x[start:end] for k, x in rows.items()})
                forces = sum(part[name] for name in _FORCES)
                self._sum = self._sum + np.sum(part["q"] + forces, axis=0)
                for accumulator in accumulators:
                    accumulator.update(part, start >= settled)

    def _complete(self, rows: Rows) -> Rows:
        """Rows as accumulators take them, see `octarm.metrics.metric.Accumulator`."""
        q, tau, force = rows["q"], rows["received"], rows["force"]
        error = q - rows["q_d"]
        return {
            **rows,
            "error": error,
            "squared_error": error * error,
            "tau": tau,
            "force": force if self._actuation is None else self._actuation.force(q, tau),
            "asked_tau": rows["tau"],
            "asked_force": force,
        }

    def result(self, diverged: npt.ArrayLike = False) -> dict[str, np.ndarray]:
        """The metrics so far, each of shape (..., 2N), or (...) for those of the arm.

        Those of arms that diverged, which broadcasts to the batch shape, are NaN, and so are those
        of arms whose q, Q or tau was not finite at any time. Raises OctarmError if there was no
        control instant.
        """
        if not self._accumulators:
            raise OctarmError("there is nothing to measure: no control instant was taken")
        with np.errstate(all="ignore"):
            results = {k: x for each in self._accumulators for k, x in each.result().items()}
        arm = {name for name in results if self._catalogue[name].of == "arm"}
        lost = np.any(~np.isfinite(self._sum), axis=-1) | np.asarray(diverged, dtype=bool)
        for name, values in results.items():  # too large to square
            infinite = np.isinf(values)
            lost = lost | (infinite if name in arm else np.any(infinite, axis=-1))
        return {
            name: np.where(lost if name in arm else lost[..., None], np.nan, values)
            for name, values in results.items()
        }


def _within(rows: Rows, settings: Settings) -> Rows:
    """The physics steps of control instants as rows, under the names of the fields of instants."""
    steps = settings.steps
    number = np.rint(rows["t"] / settings.step)[:, None] + np.arange(steps)
    within = {name: rows[f"{name}_steps"] for name in ("q", "q_d", "plant_tip") if name in rows}
    within["received"] = rows["received"]
    return {
        "t": number.ravel() * settings.step,
        "tau": _held(rows["tau"], steps),
        "force": _held(rows["force"], steps),
        **{name: x.reshape(-1, *x.shape[2:]) for name, x in within.items()},
    }


def _held(rows: np.ndarray, steps: int) -> np.ndarray:
    """Each of the rows, shape (k, ...), so many times, with the memory order of a row."""
    out = stacked(rows[0], len(rows) * steps)
    out.reshape(len(rows), steps, *rows.shape[1:])[...] = rows[:, None]
    return out


def as_json(results: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Metrics of one arm as plain numbers, or lists of shape (2N,); None stands for NaN."""
    return {
        name: np.where(np.isnan(values), None, values.astype(object)).tolist()  # pyright: ignore
        for name, values in results.items()
    }


class Column(NamedTuple):
    """A column, such as `rms_error_theta1` or `tip_rms_error`, of a table with a row for each arm.

    Attributes:
        of: the coordinate or input whose number it holds; empty for the arm.
        place: of that number along the last axis of the metric.
    """

    name: str
    metric: str
    of: str
    place: int
    unit: str
    declared: Metric

    @property
    def metadata(self) -> dict[str, str]:
        """What a table's schema says of the column, so that nobody has to parse its name."""
        return {"metric": self.metric, "of": self.of, "unit": self.unit}

    @property
    def description(self) -> dict[str, str]:
        """The same, with its meaning and which values are better."""
        return self.metadata | {"text": self.declared.text, "better": self.declared.direction}


def columns(
    coordinates: Sequence[str], units: Sequence[str], metrics: Mapping[str, Metric] = METRICS
) -> list[Column]:
    """The columns of metrics, metric by metric, for coordinates with these names and units.

    There are as many inputs, tau1 and so on.
    """
    inputs = [f"tau{i}" for i in range(1, len(coordinates) + 1)]
    held: list[Column] = []
    for name, metric in metrics.items():
        parts = {"coordinate": coordinates, "input": inputs, "arm": [""]}[metric.of]
        for place, part in enumerate(parts):
            unit = metric.unit_for(units[place] if metric.of == "coordinate" else "m")
            held.append(Column(f"{name}_{part}" if part else name, name, part, place, unit, metric))
    return held


def _lacks(thing: Any) -> str:
    """What a class of a user lacks of an accumulator; empty if nothing."""
    if not (isinstance(thing, type) and issubclass(thing, Accumulator)):
        return "is no Accumulator of octarm.metrics.metric"
    if misses := lacking(
        thing, __init__=["first", "settings"], update=["rows", "steady"], result=[]
    ):
        return misses
    metrics: Any = getattr(thing, "metrics", None)
    if not isinstance(metrics, Mapping) or not metrics:
        return "declares no metrics, a table of Metric by name"
    for name, metric in cast("Mapping[Any, Any]", metrics).items():
        if not isinstance(metric, Metric) or not re.fullmatch(r"[a-z]\w*", str(name)):
            return f"declares {quoted(name)}; it must be a Metric by a name of lower-case letters"
        if name in METRICS:
            return f"declares {name}, which is measured anyway"
    return ""


# Those of `METRICS` are always measured.
ACCUMULATORS: Declared[type[Accumulator]] = Declared(
    "metric",
    {name: each for each in METRICS.accumulators for name in each.metrics},
    _lacks,
    lambda thing: {n: {**m._asdict(), "units": [*m.units]} for n, m in thing.metrics.items()},
)


def code_of(description: Mapping[str, Any]) -> dict[str, Code]:
    """The code that a run needed and is not built in, by name, as `run.json` says it."""
    code = {"code": description.get("code", {})}
    return Document("run.json", code).read(dict[str, Code], "code")


def measured(code: Mapping[str, Code]) -> Catalogue:
    """All metrics of an experiment: those of `METRICS`, and those of its code."""
    names = [name for name, each in code.items() if each.kind == "metric"]
    return METRICS.extended(ACCUMULATORS[word_of(name, code)] for name in names)


def declared_metrics(code: Mapping[str, Code]) -> dict[str, Metric]:
    """The same by name, as results remember them; no code is imported.

    Raises OctarmError if what they remember is no declaration of a metric.
    """
    known = dict(METRICS)
    for each in code.values():
        for name, content in each.declares.items() if each.kind == "metric" else ():
            known_keys = {key: x for key, x in content.items() if key in Metric._fields}
            metric = Document(each.path, known_keys).read(Metric)
            known.setdefault(name, metric._replace(text=printable(metric.text, 200)))
    return known


def parse_bound(text: str) -> tuple[str, float]:
    """A metric and what its absolute value may be at most, from METRIC:VALUE."""
    metric, _, value = text.partition(":")
    if not value:
        raise OctarmError(f"bound is {quoted(text)}; it must read METRIC:VALUE")
    declared = [m for name, m in METRICS.items() if f"{metric}_".startswith(f"{name}_")]
    unit = " or ".join(declared[-1].units) if declared else ANY  # a user's own may have any
    sizes = not set(unit.split(" or ")) - {"m", "rad"}  # of arms, and beyond 10 m no arm is
    limit = Range(unit, plausible=10.0 if sizes else math.inf).parse(f"bound of {metric}", value)
    if not 0.0 < limit < math.inf:
        raise OctarmError(f"bound of {metric} is {limit:g}; it must be positive and finite")
    return metric, limit


def check_measures(names: Iterable[str]) -> None:
    """Raises OctarmError for a column that no run of a built-in metric has."""
    for name in names:
        if not any(f"{name}_".startswith(f"{known}_") for known in METRICS):
            raise OctarmError(f"there is no measure {quoted(name)}{closest(name, METRICS)}")

"""Metrics of a user, which are given as MODULE:NAME or FILE.py:NAME; see `octarm.declared`."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from typing import Any, cast

from octarm.declared import Code, Declared, lacking, word_of
from octarm.errors import OctarmError, closest, printable, quoted
from octarm.formats import Document
from octarm.metrics.metric import Accumulator, Metric
from octarm.metrics.table import METRICS, Catalogue
from octarm.units import ANY, number


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


def _declares(thing: type[Accumulator]) -> dict[str, dict[str, Any]]:
    return {name: {**m._asdict(), "units": [*m.units]} for name, m in thing.metrics.items()}


# Those of `METRICS` are always measured; others are given by MODULE:NAME or FILE.py:NAME.
ACCUMULATORS: Declared[type[Accumulator]] = Declared(
    "metric", {n: each for each in METRICS.accumulators for n in each.metrics}, _lacks, _declares
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
    limit = number(f"bound of {metric}", value, unit)
    if not 0.0 < limit < math.inf:
        raise OctarmError(f"bound of {metric} is {limit:g}; it must be positive and finite")
    return metric, limit


def check_measures(names: Iterable[str]) -> None:
    """Raises OctarmError for a column that no run of a built-in metric has."""
    for name in names:
        if not any(f"{name}_".startswith(f"{known}_") for known in METRICS):
            raise OctarmError(f"there is no measure {quoted(name)}{closest(name, METRICS)}")

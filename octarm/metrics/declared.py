"""Metrics of a user, which are given as MODULE:NAME or FILE.py:NAME; see `octarm.declared`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, cast

from octarm.declared import Code, Declared, lacking, word_of
from octarm.errors import printable, quoted
from octarm.formats import Document
from octarm.metrics.metric import Accumulator, Metric
from octarm.metrics.table import METRICS, Catalogue


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

    Raises:
        OctarmError: if what they remember is no declaration of a metric.
    """
    known = dict(METRICS)
    for each in code.values():
        for name, content in each.declares.items() if each.kind == "metric" else ():
            known_keys = {key: x for key, x in content.items() if key in Metric._fields}
            metric = Document(each.path, known_keys).read(Metric)
            known.setdefault(name, metric._replace(text=printable(metric.text, 200)))
    return known

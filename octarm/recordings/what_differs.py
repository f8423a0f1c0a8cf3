"""In what runs differ, of all that was recorded of how they were made."""

from __future__ import annotations

import itertools
import string
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from octarm.arm.parameters import PARAMETERS
from octarm.recordings import titles
from octarm.recordings.notes import in_words
from octarm.runs.description import USUAL

# What is not part of a run's task: two laws may differ in it and still be ranked.
_OF_THE_LAW = ("controller", "gain ", "model's ", "version ", "timestep", "control_period", "code ")
_SETTINGS = (
    "duration", "timestep", "control_period", "actuation", "integrator", "engine", "seed",
    "spawn_key", *USUAL,
)  # fmt: skip
_UNITS = {"duration": "s", "settle": "s", "timestep": "s", "control_period": "s"}


class Contrast(NamedTuple):
    """Something in which runs differ.

    Attributes:
        name: of it, with its unit, if that is known.
        values: in words, one for each run.
        of_the_task: whether it belongs to what a controller has to do rather than to how it does
            it. Runs that differ in that cannot be ranked by their errors.
    """

    name: str
    values: Sequence[str]
    of_the_task: bool


class Compared:
    """Runs beside each other, in words; `run.json` of each is given.

    Attributes:
        names: A, B and so on.
        titles: of the runs.
        differences: in what they differ.
        ranked: whether they had the same to do, so that one can be better than another.
        verdict: one sentence on that.
    """

    def __init__(self, descriptions: Sequence[Mapping[str, Any]]) -> None:
        self.names = labels(len(descriptions))
        self.titles = [titles.title_of(description) for description in descriptions]
        self.differences = differences(descriptions)
        self.ranked = not any(each.of_the_task for each in self.differences)
        self.verdict = verdict(self.differences)


def differences(descriptions: Sequence[Mapping[str, Any]]) -> list[Contrast]:
    """In what runs differ, whose `run.json` is given; gains only where the controller is the same.

    The seed belongs to the task where there are disturbances, which draw from it.
    """
    tables = [dict(_aspects(description)) for description in descriptions]
    differing: list[Contrast] = []
    for name in dict.fromkeys(name for table in tables for name in table):
        values = [table.get(name) for table in tables]
        law = name.startswith("gain ") and any(d.name == "controller" for d in differing)
        if law or all(value == values[0] for value in values):
            continue
        texts = ["–" if value is None else in_words(value) for value in values]
        if len(set(texts)) < len(set(map(repr, values))):  # digits that are not printed
            texts = ["–" if value is None else str(value) for value in values]
        task = not name.startswith(_OF_THE_LAW)
        if name in ("seed", "spawn_key"):
            task = any(each.get("disturbances") or "start" in each for each in descriptions)
        differing.append(Contrast(name.replace("_", " ") + _unit(name), texts, task))
    return differing


def verdict(differing: Sequence[Contrast]) -> str:
    """One sentence on whether runs with these differences can be ranked."""
    task = [difference.name for difference in differing if difference.of_the_task]
    if task:
        return f"Not ranked: the runs differ in what they had to do ({', '.join(task)})."
    names = ", ".join(difference.name for difference in differing) or "nothing that is recorded"
    return f"The runs had the same to do; they differ in {names}."


def labels(count: int) -> list[str]:
    """Names for so many runs: A to Z, then AA, AB and so on."""
    words = (map("".join, itertools.product(string.ascii_uppercase, repeat=n)) for n in (1, 2, 3))
    return list(itertools.islice(itertools.chain.from_iterable(words), count))


def _unit(name: str) -> str:
    """The unit of a setting, or of a parameter of the arm or of its model, in brackets."""
    whose, _, parameter = name.partition(" ")
    kind = PARAMETERS.get(parameter) if whose in ("arm's", "model's") else None
    unit = kind.unit if kind else _UNITS.get(name, "")
    return unit and f" [{unit}]"


def _aspects(description: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """What a run was made of, by name."""
    controller = description.get("controller", {})
    yield "controller", controller.get("name")
    if (status := description.get("status", "ok")) not in ("ok", "diverged"):
        yield "end", status  # of a run that is there in part
    code = description.get("code", {})
    for entry in description.get("disturbances", []):
        units = {
            key: f"{key} [{unit}]" for key, unit in titles.units_of(entry, code).items() if unit
        }
        asked = {units.get(k, k): x for k, x in entry["asked"].items() if x is not None}
        yield f"disturbance {entry['name']}", asked
    for key, value in description.get("reference", {}).items():
        yield "reference" if key == "name" else f"reference's {key}", value
    plant: Mapping[str, Any] = description.get("plant", {})
    for key in ("modules", "layout", "sensing"):
        yield f"plant's {key}", plant.get(key)
    for key in _SETTINGS:
        yield key, description.get(key, USUAL.get(key))
    for name, value in controller.get("gains", {}).items():
        yield f"gain {name.rstrip('_')}", value
    for whose, table in (("model's", "nominal"), ("arm's", "parameters")):
        for name, value in description.get(table, {}).items():
            yield f"{whose} {name}", value
    for name, each in description.get("code", {}).items():
        kind = "" if each["kind"] in ("controller", "metric") else f"{each['kind']} "
        distribution = each.get("distribution")
        parts = [each["path"], f"SHA-256 {each['sha256'][:12]}"]
        yield f"{kind}code of {name}", ", ".join(parts + ([distribution] if distribution else []))
    for name, value in description.get("versions", {}).items():
        yield f"version of {name}", value

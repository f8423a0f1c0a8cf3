"""What is known of a run as pages of text."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, cast

from octarm.metrics.table import METRICS
from octarm.recordings.channels import coordinates_of

_REMARK = """The arm is drawn as a picture of the lumped model, whose module i slides along the end
of the one before and bends at its own end. No arc of length s_i and angle theta_i ends where such a
module does; the tube is the smoothest curve through the simulated plates and tip, and turns by
theta_i over about the length s_i. `world/skeleton` is the lumped arm itself; switch it on in the
list of entities. A module is the brighter the more it is bent. Columns are red and thick where they
push, white and thick where they pull. The pale sheath is the desired arm; the red line is the last
second of the tip, the grey line its desired path. Violet arrows are the forces of disturbances, on
the scale on which the arrow of gravity is the weight of the arm; a moment on a bend is drawn as a
couple at the rim of its plate. A payload is a steel ball of its mass. V' is the rate of the V that
the controller reports. If the model were exact and nothing disturbed the arm, it would be at most s
times the robust part; where it is above, model error or a disturbance feeds V. The error, s and the
parts of the force have single precision here, E 60 rows a second, and signals with a number for
each rule are a picture; run.npz has every bit of all of them at every instant."""


def title_of(description: Mapping[str, Any]) -> str:
    """A run in a few words."""
    controller = description.get("controller", {}).get("name", "")
    reference = description.get("reference", {}).get("name", "")
    names = [entry["name"] for entry in description.get("disturbances", [])]
    title = f"{controller} on {reference}" if controller and reference else "a run"
    title = f"{title}, {' + '.join(names)}" if names else title
    episode = description.get("spawn_key")  # of a sweep
    return f"{title}, seed {'-'.join(map(str, episode))}" if episode else title


def notes_of(description: Mapping[str, Any]) -> dict[str, str]:
    """Pages of Markdown by name: `notes`, and `ledger` if there are disturbances."""
    parts = [f"# {title_of(description)}"]
    if description.get("status", "ok") != "ok":
        parts.append(f"**{description['status']}** {description.get('message', '')}".strip())
    if description.get("command"):
        parts.append(f"```\n{description['command']}\n```")
    if description.get("metrics"):
        parts.append("## Metrics\n\n" + _metrics(description))
    for heading, table in (
        ("Gains", description.get("controller", {}).get("gains")),
        ("True parameters", description.get("parameters")),
        ("Nominal parameters", description.get("nominal")),
        ("Reference", description.get("reference")),
        ("Versions", description.get("versions")),
    ):
        if table:
            rows = [[name, _text(value)] for name, value in table.items()]
            parts.append(f"## {heading}\n\n{_table(['', ''], rows)}")
    parts.append(f"## What is drawn\n\n{' '.join(_REMARK.split())}")
    pages = {"notes": "\n\n".join(parts)}
    if description.get("disturbances"):
        pages["ledger"] = _ledger(description["disturbances"])
    return pages


def _metrics(description: Mapping[str, Any]) -> str:
    """A table with a column for each coordinate; inputs stand in the order of tau."""
    names = coordinates_of(description).names
    rows: list[list[str]] = []
    for name, values in description["metrics"].items():
        numbers = cast(list[Any], values) if isinstance(values, list) else [values]
        texts = [_text(x) for x in numbers] + [""] * len(names)
        rows.append([name, *texts[: len(names)], *_meaning(name)])
    return _table(["", *names, "unit", ""], rows)


def _meaning(metric: str) -> tuple[str, str]:
    """The units of a metric and what it is; empty if it is not known."""
    meaning = METRICS.get(metric)
    if meaning is None:
        return "", ""
    return ", ".join(meaning.units), re.sub(r"\|([^|]+)\|", r"abs(\1)", meaning.text)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _ledger(disturbances: Sequence[Mapping[str, Any]]) -> str:
    """What each disturbance was asked to do and what was delivered."""
    parts = ["# Disturbances"]
    for entry in disturbances:
        delivered = entry.get("delivered")
        text = "not known yet" if delivered is None else _pairs(delivered) or "nothing"
        asked = _pairs(entry["asked"])
        parts.append(f"**{entry['name']}**\n\n- asked: {asked}\n- delivered: {text}")
    return "\n\n".join(parts)


def _pairs(table: Mapping[str, Any]) -> str:
    return "; ".join(f"{name} {_text(v)}" for name, v in table.items() if v is not None)


def _text(value: Any) -> str:
    if isinstance(value, Mapping):
        table = cast(Mapping[str, Any], value)
        return ", ".join(f"{name} {_text(item)}" for name, item in table.items())
    if isinstance(value, list):
        return "(" + ", ".join(_text(item) for item in cast(list[Any], value)) + ")"
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "–"}[value]
    return f"{value:.4g}" if isinstance(value, float) else str(value)

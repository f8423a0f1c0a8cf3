"""What is known of a run as pages of text."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, cast

from octarm.arm.mjcf import coordinate_names
from octarm.metrics.table import METRICS

_REMARK = """The arm is drawn as a picture of the lumped model, whose module i slides along the end
of the one before and bends at its own end. No arc of length s_i and angle theta_i ends where such a
module does; the tube is the smoothest curve through the simulated plates and tip, and turns by
theta_i over about the length s_i. `world/skeleton` is the lumped arm itself, to be shown from the
list of entities. A module is the brighter the more it is bent. Columns are red and thick where they
push, white and thick where they pull. The pale sheath is the desired arm, the red line the last
second of the tip beside its desired path. Violet arrows are the forces of disturbances, on the
scale on which the arrow of gravity is the weight of the arm; what acts on a bend is a couple at the
rim of its plate. A payload is a steel ball of its mass. V' is by how much the V that the controller
reports changes. If the model were exact and nothing disturbed the arm, it would be at most s times
the robust part; where it is above, model error or a disturbance feeds V. The error, s and the parts
of the force have single precision here, E 60 rows a second, and of what has a number a rule there
is a picture; run.npz has every bit of all at every instant."""


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
            rows = "\n".join(f"| {name} | {_text(value)} |" for name, value in table.items())
            parts.append(f"## {heading}\n\n| | |\n|---|---|\n{rows}")
    parts.append(f"## What is drawn\n\n{' '.join(_REMARK.split())}")
    pages = {"notes": "\n\n".join(parts)}
    if description.get("disturbances"):
        pages["ledger"] = _ledger(description["disturbances"])
    return pages


def _metrics(description: Mapping[str, Any]) -> str:
    """A table with a column a coordinate."""
    modules = len(description["parameters"]["mass"])
    head = ["", *coordinate_names(modules), "unit", ""]
    rows = [head, ["---"] * len(head)]
    for name, values in description["metrics"].items():
        meaning = METRICS.get(name)
        unit = "" if meaning is None else ", ".join(meaning.units)
        listed = cast(list[Any], values) if isinstance(values, list) else [values]
        texts = [_text(v) for v in listed]
        texts += [""] * (2 * modules - len(texts))
        rows.append([name, *texts[: 2 * modules], unit, "" if meaning is None else meaning.text])
    return "\n".join(
        "| " + " | ".join(row).replace("|q - q_d|", "abs(q - q_d)") + " |" for row in rows
    )


def _ledger(disturbances: list[dict[str, Any]]) -> str:
    """What each disturbance was asked to do and what was delivered."""
    parts = ["# Disturbances"]
    for entry in disturbances:
        delivered = entry.get("delivered")
        text = "not known yet" if delivered is None else _pairs(delivered) or "nothing"
        parts.append(f"**{entry['name']}**")
        parts.append(f"- asked: {_pairs(entry['asked'])}\n- delivered: {text}")
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

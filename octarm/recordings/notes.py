"""What is known of a run as pages of text."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, cast

from octarm.declared import Code
from octarm.errors import printable
from octarm.formats import Document
from octarm.metrics.declared import declared_metrics
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
_OF_PLANT = """ The plant has more modules than what is measured of it: the white line is its true
curve, the red line follows its tip, and the grey line the end of arcs of constant curvature of the
desired coordinates."""


_LONGEST = 200  # characters of a title, a message or a cell


def title_of(description: Mapping[str, Any]) -> str:
    """A run in a few words."""
    controller = description.get("controller", {}).get("name", "")
    reference = description.get("reference", {}).get("name", "")
    names = [entry["name"] for entry in description.get("disturbances", [])]
    plant = description.get("plant")
    names += [f"a plant of {plant['modules']} modules"] if plant else []
    title = f"{controller} on {reference}" if controller and reference else "a run"
    title = f"{title}, {' + '.join(names)}" if names else title
    episode = description.get("spawn_key")  # of a sweep
    title = f"{title}, seed {'-'.join(map(str, episode))}" if episode else title
    return printable(title, _LONGEST)


def notes_of(description: Mapping[str, Any]) -> dict[str, str]:
    """Pages of Markdown by name: `notes`, and `ledger` if there are disturbances."""
    parts = [f"# {title_of(description)}"]
    if description.get("status", "ok") != "ok":
        message = printable(description.get("message", ""), _LONGEST)
        parts.append(f"**{description['status']}** {message}".strip())
    if description.get("command"):
        parts.append(f"```\n{printable(description['command'], 10 * _LONGEST)}\n```")
    if description.get("metrics"):
        parts.append("## Metrics\n\n" + _metrics(description))
    for heading, table in (
        ("Gains", description.get("controller", {}).get("gains")),
        ("True parameters", description.get("parameters")),
        ("Nominal parameters", description.get("nominal")),
        ("Reference", description.get("reference")),
        ("Code", {name: each["path"] for name, each in description.get("code", {}).items()}),
        ("Versions", description.get("versions")),
    ):
        if table:
            rows = [[name, in_words(value)] for name, value in table.items()]
            parts.append(f"## {heading}\n\n{markdown_table(['', ''], rows)}")
    remark = _REMARK + (_OF_PLANT if description.get("plant") else "")
    parts.append(f"## What is drawn\n\n{' '.join(remark.split())}")
    pages = {"notes": "\n\n".join(parts)}
    if description.get("disturbances"):
        entries = map(_ledger, description["disturbances"])
        pages["ledger"] = "\n\n".join(["# Disturbances", *entries])
    return pages


def _metrics(description: Mapping[str, Any]) -> str:
    """A table with a column for each coordinate; inputs stand in the order of tau."""
    names = coordinates_of(description).names
    code = Document("run.json", {"code": description.get("code", {})})
    known = declared_metrics(code.read(dict[str, Code], "code"))
    rows: list[list[str]] = []
    for name, values in description["metrics"].items():
        numbers = cast(list[Any], values) if isinstance(values, list) else [values]
        texts = [in_words(x) for x in numbers] + [""] * len(names)
        units = text = ""
        if meaning := known.get(name):
            units = ", ".join(meaning.units)
            text = re.sub(r"\|([^|]+)\|", r"abs(\1)", meaning.text)
        rows.append([name, *texts[: len(names)], units, text])
    return markdown_table(["", *names, "unit", ""], rows)


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table in Markdown."""
    lines = [head, ["---"] * len(head), *rows]
    cells = ([printable(cell, _LONGEST) for cell in line] for line in lines)
    return "\n".join(f"| {' | '.join(line)} |" for line in cells)


def _ledger(entry: Mapping[str, Any]) -> str:
    """What a disturbance was asked to do and what was delivered."""
    asked, delivered = (
        None
        if table is None
        else "; ".join(f"{name} {in_words(x)}" for name, x in table.items() if x is not None)
        for table in (entry["asked"], entry.get("delivered"))
    )
    delivered = "not known yet" if delivered is None else delivered or "nothing"
    lines = (f"**{entry['name']}**", "", f"- asked: {asked}", f"- delivered: {delivered}")
    return "\n".join(printable(line, 10 * _LONGEST) for line in lines)


def in_words(value: Any) -> str:
    """A value of `run.json` as people read it: numbers with four digits, tables in a line."""
    if isinstance(value, Mapping):
        table = cast(Mapping[str, Any], value)
        return ", ".join(f"{name} {in_words(item)}" for name, item in table.items())
    if isinstance(value, list):
        return "(" + ", ".join(in_words(item) for item in cast(list[Any], value)) + ")"
    if isinstance(value, bool) or value is None:
        return {True: "yes", False: "no", None: "–"}[value]
    return f"{value:.4g}" if isinstance(value, float) else str(value)

"""What is known of a run as pages of text."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Any, cast

from octarm.arm.parameters import PARAMETERS
from octarm.errors import printable
from octarm.metrics.declared import code_of, declared_metrics
from octarm.recordings.channels import coordinates_of
from octarm.recordings.titles import LONGEST, class_of, disturbance_of, title_of, units_of

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


_UNITS = {name: kind.unit for name, kind in PARAMETERS.items()} | {"gravity_angle": "rad"}
_SIGNAL_UNITS = {"forces": "N, N m", "the inputs": "N", "the readings": "m, rad, m/s, rad/s"}


def notes_of(description: Mapping[str, Any]) -> dict[str, str]:
    """Pages of Markdown by name: `notes`, and `ledger` if there are disturbances."""
    parts = [f"# {title_of(description)}"]
    if description.get("status", "ok") != "ok":
        message = printable(description.get("message", ""), LONGEST)
        parts.append(f"**{description['status']}** {message}".strip())
    if description.get("command"):
        parts.append(f"```\n{printable(description['command'], 10 * LONGEST)}\n```")
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
        code = description.get("code", {})
        entries = [_ledger(entry, code) for entry in description["disturbances"]]
        pages["ledger"] = "\n\n".join(["# Disturbances", *entries])
    return pages


def _metrics(description: Mapping[str, Any]) -> str:
    """A table with a column for each coordinate; inputs stand in the order of tau."""
    names = coordinates_of(description).names
    known = declared_metrics(code_of(description))
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
    cells = ([printable(cell, LONGEST) for cell in line] for line in lines)
    return "\n".join(f"| {' | '.join(line)} |" for line in cells)


def _ledger(entry: Mapping[str, Any], code: Mapping[str, Any]) -> str:
    """What a disturbance was asked to do and what was delivered, as a table with units."""
    units = {name: "" if unit == "1" else unit for name, unit in units_of(entry, code).items()}
    rows = [
        ["asked", name, in_words(value), units.get(name, "")]
        for name, value in entry["asked"].items()
        if value is not None
    ]
    delivered = cast("dict[str, Any] | None", entry.get("delivered"))
    for name, value in (delivered or {}).items():
        change = cast(dict[str, Any], value) if isinstance(value, dict) else {}
        if "undisturbed" in change and "end" in change:  # a parameter of the arm
            value = f"{in_words(change['undisturbed'])} → {in_words(change['end'])}"
        unit = _UNITS.get(name) or _signal_unit(entry, name) or units.get(name, "")
        rows.append(["delivered", name, in_words(value), unit])
    if not delivered:
        rows.append(["delivered", "not known yet" if delivered is None else "nothing", "", ""])
    rows = [
        [first, name.replace("_", " ") + (f" [{unit}]" if unit else ""), value]
        for first, name, value, unit in rows
    ]
    heading = printable(disturbance_of(entry, code), LONGEST)
    return f"## {heading}\n\n{markdown_table(['', '', ''], rows)}"


def _signal_unit(entry: Mapping[str, Any], name: str) -> str:
    """The unit of what was measured of the signal of a disturbance that is built in."""
    cls = class_of(entry)
    if cls is None or name in cls.units:
        return "" if cls is None else cls.units[name]
    known = name.startswith(("rms", "peak")) or name == "unexplained"
    return _SIGNAL_UNITS.get(cls.family, "") if known else ""


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

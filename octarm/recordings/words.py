"""What is known of a run in words: a title that stands alone, events, and pages of text."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from octarm.arm.parameters import PARAMETERS
from octarm.disturbances.spelling import DISTURBANCES
from octarm.errors import printable
from octarm.fields import Quantity, field_defaults, field_kinds
from octarm.metrics.table import code_of, declared_metrics
from octarm.recordings.channels import coordinates_of, disturbances_of

LONGEST = 200  # characters of a title, a message or a cell
_SMALL = {"m": "mm", "rad": "mrad", "kg": "g", "s": "ms"}  # units, and what small values have
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


def amount(value: Any, unit: str) -> str:
    """A number with its unit as people write it: `40 %`, `100 g`, `60 ms`; lists by their ends."""
    if isinstance(value, list | tuple):
        numbers = sorted({float(x) for x in np.ravel(cast(Any, value))})
        if len(numbers) != 1:
            return f"{amount(numbers[0], unit)} to {amount(numbers[-1], unit)}" if numbers else ""
        value = numbers[0]
    if not isinstance(value, int | float) or isinstance(value, bool):
        return str(value)
    if unit == "1":
        return f"{100.0 * value:.3g} %"
    if unit in _SMALL and 0.0 < abs(value) < (1.0 if unit == "kg" else 0.1):
        value, unit = 1e3 * value, _SMALL[unit]
    return f"{value:.4g} {unit}".strip()


def title_of(description: Mapping[str, Any]) -> str:
    """A run in one line: controller, desired motion, disturbances, plant and model error."""
    controller = description.get("controller", {}).get("name", "")
    reference = description.get("reference", {})
    named = controller and reference.get("name")
    first = f"{controller} on {motion_of(reference)}" if named else "a run"
    parts = [first, *conditions_of(description)]
    if episode := description.get("spawn_key"):  # of a sweep
        parts.append(f"seed {'-'.join(map(str, episode))}")
    return printable(", ".join(parts), LONGEST)


def short_title_of(description: Mapping[str, Any], letters: int) -> str:
    """The same in so many letters: without sizes if it is longer, and cut if that is, too."""
    title = title_of(description)
    if len(title) > letters:
        title = re.sub(r" \([^)]*\)", "", title, count=1)  # of the desired motion
    if len(title) > letters:
        acting = [str(entry["name"]) for entry in description.get("disturbances", [])]
        title = ", ".join([title.partition(", ")[0], *acting])
    return title if len(title) <= letters else f"{title[: letters - 2]} …"


def wrapped(title: str, letters: int) -> str:
    """A title in lines of at most so many letters, each number beside its unit."""
    for unit in ("%", "g", "ms", "s", "Hz", "rad"):
        title = re.sub(rf"(?<=\d) (?={unit}(?:\W|$))", "\u00a0", title)
    title = title.replace("model ", "model\u00a0")
    return textwrap.fill(title, letters, break_on_hyphens=False)


def conditions_of(description: Mapping[str, Any]) -> list[str]:
    """What makes the run harder than one without any of it: disturbances, plant, start, model."""
    code = description.get("code", {})
    parts = [disturbance_of(entry, code) for entry in description.get("disturbances", [])]
    plant = description.get("plant")
    parts += [f"a plant of {plant['modules']} modules"] if plant else []
    parts += [f"{description['start']} start"] if "start" in description else []
    return parts + _model_error(description)


def disturbance_of(entry: Mapping[str, Any], code: Mapping[str, Any]) -> str:
    """An entry of `run.json` in words, such as `payload 100 g at 3 s`, and the code of the run."""
    asked, cls = entry["asked"], class_of(entry)
    usual = field_defaults(cls) if cls else {}
    units = units_of(entry, code)
    given = [x for x in units if asked.get(x) not in (None, [], usual.get(x))]
    size = amount(asked[given[0]], units[given[0]]) if given else ""
    at = f"at {amount(asked['at'], 's')}" if asked.get("at") else ""
    return " ".join(filter(None, (str(entry["name"]), size, at)))


def events_of(description: Mapping[str, Any]) -> list[tuple[float, str, str]]:
    """When disturbances begin and end [s], by time, with their names and what then begins.

    The text is empty where a disturbance ends.
    """
    events: list[tuple[float, str, str]] = []
    entries = description.get("disturbances", [])
    for entry, drawn in zip(entries, disturbances_of(description), strict=True):
        entry_now = {**entry, "asked": {**entry["asked"], "at": None}}
        text = disturbance_of(entry_now, description.get("code", {}))
        events += [(at, entry["name"], text if begins else "") for at, begins in drawn.moments]
    return sorted(events)


def class_of(entry: Mapping[str, Any]) -> Any:
    """The class of a disturbance that is built in; None of another one."""
    return DISTURBANCES.get(re.sub(r"-\d+$", "", str(entry["name"])))


def units_of(entry: Mapping[str, Any], code: Mapping[str, Any]) -> dict[str, str]:
    """The units of the numbers that a disturbance was asked for, by name; its size comes first.

    Of a disturbance that is not built in they are those that the `code` of the run declares, which
    is not imported.
    """
    cls = class_of(entry)
    if cls is None:
        declared = code.get(re.sub(r"-\d+$", "", str(entry["name"])), {}).get("declares", {})
        units = {said.get("field"): str(said.get("unit", "")) for said in declared.values()}
        sizes = entry["asked"].items()
        return {n: units.get(n, "") for n, x in sizes if isinstance(x, int | float | list)}
    kinds = field_kinds(cls)
    return {name: kind.unit for name, kind in kinds.items() if isinstance(kind, Quantity)}


def motion_of(reference: Mapping[str, Any]) -> str:
    """A desired motion in words, such as `sine (0.35, 0.25 rad at 0.5 Hz)`."""
    numbers, sizes = dict(reference), list[str]()
    try:
        if tones := numbers.get("tones"):
            largest = np.max([np.abs(tone["amplitude"]) for tone in tones], axis=0).tolist()
            numbers |= {"amplitude": largest, "frequency": [tone["frequency"] for tone in tones]}
        if "amplitude" in numbers:
            sizes.append(_sizes(numbers["amplitude"]))
        if "frequency" in numbers:
            sizes.append(f"at {amount(numbers['frequency'], 'Hz')}")
        if "goal" in numbers and "start" in numbers:
            sizes = [f"by {_sizes(np.subtract(numbers['goal'], numbers['start']).tolist())}"]
    except (KeyError, TypeError, ValueError):  # a user's fields of these names may hold anything
        sizes = []
    return f"{numbers['name']} ({' '.join(sizes)})" if any(sizes) else str(numbers["name"])


def _sizes(values: Sequence[float]) -> str:
    """The sizes of what moves of q = [s1..sN, theta1..thetaN], slides in mm."""
    n, parts = len(values) // 2, list[str]()
    for group, scale, unit in ((values[n:], 1.0, "rad"), (values[:n], 1e3, "mm")):
        moving = [f"{scale * abs(x):.3g}" for x in group if abs(x) > 1e-12]
        if len(moving) > 3:
            moving = [f"up to {max(moving, key=float)}"]
        parts += [f"{', '.join(moving)} {unit}"] if moving else []
    return " and ".join(parts)


def _model_error(description: Mapping[str, Any]) -> list[str]:
    """By how much the controller's model is wrong; nothing where that is another plant's."""
    true, nominal = description.get("parameters"), description.get("nominal")
    if not true or not nominal or true == nominal or description.get("plant"):
        return []
    shares = {"mass": 1.0, "inertia": 1.0, "damping": 1.0, "stiffness": 0.5}
    with np.errstate(all="ignore"):
        try:
            ratios = {name: np.divide(nominal[name], true[name]) for name in shares}
        except (KeyError, TypeError, ValueError):
            return ["another model"]
    wrong = float(ratios["mass"].flat[0]) - 1.0
    alike = all(np.allclose(x, 1.0 + shares[name] * wrong) for name, x in ratios.items())
    return [f"model {100.0 * wrong:+.3g} %"] if alike and wrong else ["another model"]


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
    if entries := description.get("disturbances"):
        tables = [_ledger(entry, description.get("code", {})) for entry in entries]
        pages["ledger"] = "\n\n".join(["# Disturbances", *tables])
    return pages


def _metrics(description: Mapping[str, Any]) -> str:
    """A table with a column for each coordinate; inputs stand in the order of tau."""
    names = coordinates_of(description).names
    known = declared_metrics(code_of(description))
    rows: list[list[str]] = []
    for name, values in description["metrics"].items():
        numbers = cast(list[Any], values) if isinstance(values, list) else [values]
        texts = [in_words(x) for x in numbers] + [""] * len(names)
        units, text = (
            (", ".join(known[name].units), known[name].text) if name in known else ("", "")
        )
        text = re.sub(r"\|([^|]+)\|", r"abs(\1)", text)
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
    rows: list[list[str]] = []

    def add(first: str, name: str, value: Any, unit: str) -> None:
        rows.append([first, name.replace("_", " ") + (f" [{unit}]" if unit else ""), value])

    for name, value in entry["asked"].items():
        if value is not None:
            add("asked", name, in_words(value), units.get(name, ""))
    delivered = cast("dict[str, Any] | None", entry.get("delivered"))
    for name, value in (delivered or {}).items():
        change = cast(dict[str, Any], value) if isinstance(value, dict) else {}
        if "undisturbed" in change and "end" in change:  # a parameter of the arm
            value = f"{in_words(change['undisturbed'])} → {in_words(change['end'])}"
        unit = _UNITS.get(name) or _signal_unit(entry, name) or units.get(name, "")
        add("delivered", name, in_words(value), unit)
    if not delivered:
        add("delivered", "not known yet" if delivered is None else "nothing", "", "")
    heading = printable(disturbance_of(entry, code), LONGEST)
    return f"## {heading}\n\n{markdown_table(['', '', ''], rows)}"


def _signal_unit(entry: Mapping[str, Any], name: str) -> str:
    """The unit of what was measured of the signal of a disturbance that is built in."""
    cls = class_of(entry)
    if cls is None:
        return ""
    measured = name.startswith(("rms", "peak")) or name == "unexplained"
    return cls.units.get(name, _SIGNAL_UNITS.get(cls.family, "") if measured else "")


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

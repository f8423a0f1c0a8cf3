"""A run in words that stand alone: what controls what, and what disturbs it, with sizes."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from octarm.disturbances.spelling import DISTURBANCES
from octarm.errors import printable
from octarm.fields import Quantity, field_defaults, field_kinds
from octarm.recordings.channels import disturbances_of

LONGEST = 200  # characters of a title, a message or a cell
_SMALL = {"m": "mm", "rad": "mrad", "kg": "g", "s": "ms"}  # units, and what small values have


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
    episode = description.get("spawn_key")  # of a sweep
    parts += [f"seed {'-'.join(map(str, episode))}"] if episode else []
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
    disturbances = disturbances_of(description)
    for entry in description.get("disturbances", []):
        entry_now = {**entry, "asked": {**entry["asked"], "at": None}}
        text = disturbance_of(entry_now, description.get("code", {}))
        for at, begins in disturbances[entry["name"]].moments:
            events.append((at, entry["name"], text if begins else ""))
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
    name = str(reference["name"])
    try:
        sizes = _motion_sizes(dict(reference))
    except (KeyError, TypeError, ValueError):  # a user's fields of these names may hold anything
        sizes = []
    return f"{name} ({' '.join(sizes)})" if any(sizes) else name


def _motion_sizes(numbers: dict[str, Any]) -> list[str]:
    if tones := numbers.get("tones"):
        largest = np.max([np.abs(tone["amplitude"]) for tone in tones], axis=0).tolist()
        numbers |= {"amplitude": largest, "frequency": [tone["frequency"] for tone in tones]}
    sizes = [_sizes(numbers["amplitude"])] if "amplitude" in numbers else []
    if "frequency" in numbers:
        sizes.append(f"at {amount(numbers['frequency'], 'Hz')}")
    if "goal" in numbers and "start" in numbers:
        sizes = [f"by {_sizes(np.subtract(numbers['goal'], numbers['start']).tolist())}"]
    return sizes


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
    names = ("mass", "inertia", "damping", "stiffness")
    with np.errstate(all="ignore"):
        try:
            ratios = {name: np.divide(nominal[name], true[name]) for name in names}
        except (KeyError, TypeError, ValueError):
            return ["another model"]
    wrong = float(ratios["mass"].flat[0]) - 1.0
    alike = all(
        np.allclose(ratio, 1.0 + (0.5 if name == "stiffness" else 1.0) * wrong)
        for name, ratio in ratios.items()
    )
    return [f"model {100.0 * wrong:+.3g} %"] if alike and wrong else ["another model"]

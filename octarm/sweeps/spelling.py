"""How a sweep's TOML file spells things."""

from __future__ import annotations

import json
from typing import Any

from octarm.disturbances.fields import field_kinds
from octarm.disturbances.spelling import DISTURBANCES
from octarm.sweeps.spec import Axis, RandomAxis, SweepSpec, which
from octarm.toml_table import items


def spoken(disturbance: str) -> dict[str, str]:
    """The fields of a disturbance as the code spells them, by how files do."""
    kinds = field_kinds(DISTURBANCES[which(disturbance).kind])
    return {kind.key or field: field for field, kind in kinds.items()}


def as_toml(spec: SweepSpec) -> str:
    """A file that `octarm.sweeps.parser.parse_spec` makes this spec of."""

    def rows(kind: type) -> dict[str, list[str]]:
        """The lines of the axes of one kind: controller and such, and disturbances."""
        out: dict[str, list[str]] = {"": [], ".disturbance": []}
        for axis in (*spec.axes, *spec.random):
            if isinstance(axis, kind):
                key = _spelt(axis.disturbance, axis.field) if axis.disturbance else axis.name
                value = _toml_axis(axis)
                out[".disturbance" if axis.disturbance else ""].append(f"{key} = {value}")
        return out

    plain = ("seed", "episodes", "duration", "timestep", "control_period", "actuation", "batch")
    given = {name: getattr(spec, name) for name in plain}
    sections = {"": [f"{name} = {_toml(v)}" for name, v in given.items() if v is not None]}
    for heading, kind in (("grid", Axis), ("random", RandomAxis)):
        sections |= {f"{heading}{place}": lines for place, lines in rows(kind).items()}
    sections["disturbance"] = [
        f"{_spelt(name, field)} = {_toml(value)}"
        for name, fields in spec.fixed.items()
        for field, value in fields.items()
    ]
    sections["gain_set"] = [f"{name} = {_toml(own)}" for name, own in spec.gain_sets.items()]
    for name, gains in spec.gains.items():
        sections[f"gains.{name}"] = [f"{gain} = {_toml(value)}" for gain, value in gains.items()]
    sections["record"] = [f"episodes = {_toml(list(spec.record))}"]
    blocks = ["\n".join([f"[{k}]"] * bool(k) + lines) for k, lines in sections.items() if lines]
    return "\n\n".join(blocks) + "\n"


def _spelt(disturbance: str, field: str) -> str:
    """A field as files spell it, such as `noise.time`."""
    keys = {own: key for key, own in spoken(disturbance).items()}
    return f"{disturbance}.{keys[field]}"


def _toml_axis(axis: Axis | RandomAxis) -> str:
    if isinstance(axis, Axis):
        return _toml(list(axis.values))
    bounds = f"low = {_toml(axis.low)}, high = {_toml(axis.high)}"
    return f"{{ {bounds}, method = {_toml(axis.method)} }}"


def _toml(value: Any) -> str:
    """A number, a word or a list of them."""
    if (listed := items(value)) is not None:
        return f"[{', '.join(map(_toml, listed))}]"
    return str(value) if isinstance(value, float) else json.dumps(value)

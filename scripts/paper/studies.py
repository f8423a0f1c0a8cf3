"""The studies, as sweeps: who runs in which cells, and for how long."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import Any, NamedTuple

from octarm.sweeps.spec import SweepSpec
from octarm.sweeps.spec_file import parse_spec
from paper.effort import Effort
from paper.variants import (
    AS_PRINTED,
    CONSEQUENT,
    CONTROLLERS,
    FIXED_PREMISES,
    INTEGRAL,
    MATCHED,
    PROPOSED,
    SIGN,
    SMC,
    TWISTING,
    Cast,
    Variant,
    by_hand,
)

BENDS, SLIDES = "sine", "sine-slides"  # the two readings of "first two links"
MODELS = (-0.3, 0.0, 0.3)  # model errors of the paper's figures [1]
WRONG = -0.3  # the one model error of the studies that vary something else
NOISE = 0.4  # the paper's: rms over the amplitude of the input signal [1]
TIME = 0.01  # correlation time of the noise [s]
RATE = 2000.0  # [Hz]

# Beyond the paper: what acts, its column, its values, and the one that claim (f) takes.
BEYOND: Mapping[str, tuple[str, tuple[float, ...], float]] = {
    "payload": ("payload", (0.0, 0.05, 0.1, 0.2), 0.1),  # [kg]; the arm has 0.75 kg
    "delay": ("actuation-delay", (0.0, 0.0005, 0.001, 0.002), 0.001),  # [s]
    "loss": ("loss", (0.0, 0.1, 0.3, 0.5), 0.3),  # share of the force of every column
}
SEED = 0


class Part(NamedTuple):
    """A sweep.

    Attributes:
        study: that it belongs to.
        name: of its folder.
        spec: what is run.
        labels: of the variants, by controller.
    """

    study: str
    name: str
    spec: SweepSpec
    labels: Mapping[str, str]

    @property
    def seconds(self) -> float:
        """What it simulates, all arms counted [s]."""
        count = self.spec.episodes
        for axis in self.spec.axes:
            count *= len(axis.values)
        return count * self.spec.duration


class Grid(NamedTuple):
    """What differs between the episodes of a sweep, beside controllers and seeds.

    Attributes:
        reference: names.
        mismatch: of the nominal model [1].
        acting: values of disturbances by name.
        timing: physics step and control period, where they are not the usual ones [s].
    """

    reference: str = BENDS
    mismatch: Sequence[float] = (WRONG,)
    acting: Mapping[str, Sequence[float]] = MappingProxyType({})
    timing: Mapping[str, float] = MappingProxyType({})


def parts(cast: Cast, effort: Effort) -> list[Part]:
    """All sweeps."""
    found = [*_tracking(cast, effort), *_beyond(cast, effort), *_rates(cast, effort)]
    who = [cast[label] for label in (SIGN, SMC, INTEGRAL, PROPOSED)]
    if effort.times:
        grid = Grid(acting={"noise": [NOISE], "noise.time": effort.times})
        found.append(_sweep("correlation", "", who, effort.seeds, effort.short, grid))
    if effort.noises:
        grid = Grid(acting={"noise": effort.noises})
        found.append(_sweep("degradation", "", who, effort.seeds, effort.short, grid))
        found.append(_sweep("degradation", "quiet", who, 1, effort.short, Grid()))
    return found


def _tracking(cast: Cast, effort: Effort) -> list[Part]:
    """The main study: figures 1 and 2, ablations, both gain sets."""
    found: list[Part] = []
    for name, (labels, reference, noisy) in _groups(effort).items():
        variants = [cast[label] for label in labels]
        long = effort.duration
        if effort.apart or not noisy:
            grid = Grid(reference, effort.mismatches, {"noise": [0.0]})
            found.append(_sweep("tracking", f"{name}-quiet", variants, 1, long, grid))
        if noisy:
            noises = [NOISE] if effort.apart else [0.0, NOISE]
            grid = Grid(reference, MODELS, {"noise": noises})
            found.append(_sweep("tracking", name, variants, effort.seeds, long, grid))
    return found


def _groups(effort: Effort) -> dict[str, tuple[Sequence[str], str, bool]]:
    """Labels, reference, and whether there are episodes with noise, too, by name."""
    hand = [by_hand(name) for name in (SMC, PROPOSED)]
    if not effort.complete:
        return {
            "tuned": ((SIGN, SMC, CONSEQUENT, PROPOSED), BENDS, True),
            "slides": ((SMC, PROPOSED), SLIDES, True),
            "hand-set": (hand, BENDS, False),
            "premises": ((FIXED_PREMISES,), BENDS, True),
            "printed": ((AS_PRINTED,), BENDS, False),
        }
    more = [by_hand(name) for name in (SIGN, INTEGRAL, CONSEQUENT)]
    return {
        "tuned": (CONTROLLERS, BENDS, True),
        "slides": ((SIGN, SMC, INTEGRAL, CONSEQUENT, PROPOSED), SLIDES, True),
        "hand-set": ([*hand, *more], BENDS, True),
        "hand-set-slides": (hand, SLIDES, False),
        "premises": ((FIXED_PREMISES,), BENDS, True),
        "premises-slides": ((FIXED_PREMISES,), SLIDES, True),
        "printed": ((AS_PRINTED,), BENDS, True),
        "matched": ((MATCHED,), BENDS, True),
        "matched-slides": ((MATCHED,), SLIDES, True),
    }


def _beyond(cast: Cast, effort: Effort) -> list[Part]:
    """What the paper does not try, without noise: one thing at a time, or all combinations."""
    if not effort.complete:
        grid = Grid(acting={axis: (0.0, shown) for axis, _, shown in BEYOND.values()})
        return [_sweep("beyond", "", [cast[SMC], cast[PROPOSED]], 1, effort.short, grid)]
    everybody = [cast[name] for name in CONTROLLERS]
    return [
        _sweep("beyond", name, everybody, 1, effort.short, Grid(BENDS, MODELS, {axis: values}))
        for name, (axis, values, _) in BEYOND.items()
    ]


def _rates(cast: Cast, effort: Effort) -> list[Part]:
    """Control at other rates, with and without noise."""
    who = [cast[label] for label in (SIGN, SMC, TWISTING, PROPOSED)]
    found: list[Part] = []
    for rate in effort.rates:
        timing = {"control_period": 1.0 / rate, "timestep": min(1.0 / rate, 1.0 / RATE)}
        for noise, seeds, name in ((0.0, 1, "quiet"), (NOISE, effort.seeds, "")):
            grid = Grid(acting={"noise": [noise]}, timing=timing)
            found.append(_sweep(study_of_rate(rate), name, who, seeds, effort.short, grid))
    return found


def study_of_rate(rate: float) -> str:
    """The study at a control rate [Hz]; the default one is that of the main study."""
    return "tracking" if rate == RATE else f"rate-{rate:g}"


def _sweep(
    study: str, name: str, variants: Sequence[Variant], seeds: int, duration: float, grid: Grid
) -> Part:
    """A sweep of variants, no two of the same controller."""
    acting = {key: list(values) for key, values in grid.acting.items()}
    sections: dict[str, Mapping[str, Any]] = {
        "": {"seed": SEED, "episodes": seeds, "duration": duration, **grid.timing},
        "grid": {
            "controller": [variant.controller for variant in variants],
            "reference": [grid.reference],
            "mismatch": list(grid.mismatch),
        },
    }
    if "noise.time" in acting:  # the table noise then holds the ratio as well
        acting["noise.ratio"] = acting.pop("noise")
    elif "noise" in acting:
        sections["disturbance"] = {"noise.time": TIME}
    if acting:
        sections["grid.disturbance"] = acting
    sections |= {f"gains.{variant.controller}": variant.gains for variant in variants}
    labels = {variant.controller: variant.label for variant in variants}
    folder = f"{study}-{name}".rstrip("-")
    return Part(study, folder, parse_spec(_toml(sections), folder), labels)


def _toml(sections: Mapping[str, Mapping[str, Any]]) -> str:
    """The text of a spec; numbers, words and lists of them are spelt as in JSON."""
    blocks: list[str] = []
    for heading, table in sections.items():
        rows = [f"{key} = {json.dumps(value)}" for key, value in table.items()]
        blocks.append("\n".join(([f"[{heading}]"] if heading else []) + rows))
    return "\n\n".join(blocks) + "\n"

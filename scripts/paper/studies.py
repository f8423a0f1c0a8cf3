"""The studies: the sweeps of `studies.toml`, and what else is run.

Each becomes specs that `octarm sweep` runs as they stand: with the controllers that its labels
name, and all their gains. Cells without noise get one seed: nothing in them is random.
"""

import dataclasses
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from octarm.arrays import coordinate_names
from octarm.simulation.engines import usual_engine
from octarm.sweeps.tune_cost import BEND_SCALE, SLIDE_SCALE
from paper.variants import Variant

BENDS, SLIDES = "sine", "sine-slides"  # the two readings of "first two links"
READINGS = {BENDS: "bends", SLIDES: "slides"}
MOVING = {BENDS: ("theta1", "theta2"), SLIDES: ("s1", "s2")}  # what each of them moves
MODELS = (-0.3, 0.0, 0.3)  # model errors of the paper's figures [1]
MEAN = "mean"  # of these, episode by episode, instead of a model error
MODULES = 3  # that every controller believes in
WRONG = -0.3  # the one model error of the studies that vary something else
NOISE = 0.4  # the paper's: rms over the amplitude of the input signal [1]
TIME = 0.01  # correlation time of the noise [s]
RATE = 2000.0  # of control [Hz]
SETTLED = 2.0  # errors count from here on [s]
SEED = 0
COORDINATES = coordinate_names(MODULES)  # in the order of q
SCALE = np.repeat([SLIDE_SCALE, BEND_SCALE], MODULES)  # A, the motions' mean amplitude [m], [rad]


class Cell(NamedTuple):
    """Episodes that differ in their seed alone."""

    label: str  # of the variant
    study: str = "tracking"  # that they belong to; see `title`
    reference: str = BENDS  # name
    mismatch: float | str = 0.0  # of the nominal model [1]; or `MEAN`
    noise: float = 0.0  # its rms over the input's amplitude [1]
    time: float = TIME  # its correlation time [s]
    payload: float = 0.0  # [kg]
    delay: float = 0.0  # of actuation [s]
    loss: float = 0.0  # of actuation [1]
    plant: int = MODULES  # number of modules of the arm that is controlled
    rate: float = RATE  # of control [Hz]

    @property
    def title(self) -> str:
        """The study, with the rate where that varies."""
        if self.study == "plants" or self.rate != RATE:
            return f"{self.study.replace('tracking', 'rate')}-{self.rate:g}"
        return self.study if self.time == TIME else "correlation"

    def models(self) -> "list[Cell]":
        """The cells that it stands for."""
        models = MODELS if self.mismatch == MEAN else (self.mismatch,)
        return [self._replace(mismatch=model) for model in models]

    def of(self, labels: Iterable[str]) -> "list[Cell]":
        """The same place for each of these variants."""
        return [self._replace(label=label) for label in labels]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Effort:
    """How much is run, as `studies.toml` says it."""

    name: str  # `full` or `quick`
    engine: str = usual_engine()  # of all that does not say its own
    sweeps: Sequence[Mapping[str, Any]]  # in the order in which cells are listed
    seeds: int  # in each cell with noise
    duration: float  # of the runs of figures 1 and 2 [s]
    labels: Sequence[str]  # of the variants of figures 1 and 2
    readings: Sequence[str]  # references of figures 1 and 2
    long: float  # duration of the runs that show drift; none if 0 [s]
    rates: Sequence[float]  # at which Lyapunov functions are looked at [Hz]
    lyapunov: Sequence[str]  # labels of the variants of which they are looked at
    plants: Sequence[int]  # modules of the arms whose controllers believe in three
    plant_rates: Sequence[float]  # of control, for them [Hz]
    plant_labels: Sequence[str]  # of the variants that are tried on them


_STUDIES = tomllib.loads(Path(__file__).with_name("studies.toml").read_text("utf-8"))
FULL, QUICK = (Effort(name=name, **_STUDIES[name]) for name in ("full", "quick"))
BEYOND: Mapping[str, Mapping[str, float]] = _STUDIES["beyond"]  # by field of a cell and in words


class Sweep(NamedTuple):
    """What is run of a study."""

    name: str  # of its folder
    study: str  # that its cells belong to
    content: Mapping[str, Any]  # of the spec
    labels: Mapping[str, str]  # of the variants, by controller
    rate: float  # of control [Hz]


def sweeps(variants: Mapping[str, Variant], effort: Effort) -> Iterator[Sweep]:
    """All sweeps; one for each list of labels, and cells without noise apart."""
    for entry in effort.sweeps:
        content = {"engine": effort.engine, "duration": effort.duration, **entry}
        name, study, labels = (content.pop(key) for key in ("name", "study", "labels"))
        rate = round(1.0 / content.get("control_period", 1.0 / RATE), 6)
        parts = [("", content)] if effort.name == "quick" else _quiet_apart(content)
        for (i, some), (ending, part) in product(enumerate(labels), parts):
            own = {variants[label].controller: label for label in some}
            grid = {"controller": list(own), **part["grid"]}
            gains = {one: dict(variants[label].gains) for one, label in own.items()}
            spec = {"seed": SEED, **part, "grid": grid, "gains": gains}
            yield Sweep(f"{name}{f'-{i}' if i else ''}{ending}", study, spec, own, rate)


def _quiet_apart(content: Mapping[str, Any]) -> list[tuple[str, Mapping[str, Any]]]:
    """A spec in two: without noise and one seed, and with noise for the models of the figures."""
    grid = content["grid"]
    kinds, noises = grid.get("disturbance", {}), grid.get("disturbance", {}).get("noise", [])
    if 0.0 not in noises:
        return [("", content)]
    quiet = {**grid, "disturbance": {**kinds, "noise": [0.0]}}
    noisy = {**grid, "mismatch": [m for m in grid["mismatch"] if m in MODELS],
             "disturbance": {**kinds, "noise": [noise for noise in noises if noise]}}  # fmt: skip
    return [("-quiet", {**content, "episodes": 1, "grid": quiet}), ("", {**content, "grid": noisy})]

"""What is compared, and in which studies: variants of controllers, and the sweeps they stand in.

A variant is a controller of the command line with all its gains written out, so that a sweep it
stands in can be run by `octarm sweep` and `octarm verify` alone. The sweeps are tables of
`full.toml` and `quick.toml`.
"""

from __future__ import annotations

import dataclasses
import importlib.resources
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import tomlkit

from controllers import make_controller
from octarm.arm.mjcf import nominal_parameters
from octarm.sweeps.spec import SweepSpec
from octarm.sweeps.spec_file import parse_spec
from octarm.sweeps.tune import gains_of

CONTROLLERS = (
    "pd", "computed-torque", "fuzzy",
    "smc", "smc-boundary", "smc-integral", "super-twisting",
    "fsmc", "afsmc-consequent", "afsmc",
)  # fmt: skip
SIGN, SMC, PROPOSED = "smc", "smc-boundary", "afsmc"  # the paper's two, SMC in both its forms
INTEGRAL, CONSEQUENT, TWISTING = "smc-integral", "afsmc-consequent", "super-twisting"
FIXED_PREMISES = "afsmc, eta3 = eta4 = 0"
AS_PRINTED = "afsmc, sgn as printed"
MATCHED = "smc-boundary, matched slope"
UNGUARDED = "afsmc, no safeguards"
ABLATIONS = (FIXED_PREMISES, AS_PRINTED, UNGUARDED, MATCHED)

BENDS, SLIDES = "sine", "sine-slides"  # the two readings of "first two links"
MOVING = {BENDS: ("theta1", "theta2"), SLIDES: ("s1", "s2")}  # what each reading moves
MODELS = (-0.3, 0.0, 0.3)  # model errors of the paper's figures [1]
WRONG = -0.3  # the one model error of the studies that vary something else
NOISE = 0.4  # the paper's: rms over the amplitude of the input signal [1]
TIME = 0.01  # correlation time of the noise [s]
RATE = 2000.0  # of control [Hz]
SEED = 0


class Stress(NamedTuple):
    """A disturbance that the paper does not try.

    Attributes:
        values: that it takes, in SI units, 0 first.
        tested: the one that claim (f) takes.
        unit: for tables and figures.
        factor: from SI to that unit.
    """

    values: tuple[float, ...]
    tested: float
    unit: str
    factor: float


BEYOND = {
    "payload": Stress((0.0, 0.05, 0.1, 0.2), 0.1, "kg", 1.0),  # the arm has 0.75 kg
    "delay": Stress((0.0, 0.0005, 0.001, 0.002), 0.001, "ms", 1e3),  # of actuation
    "loss": Stress((0.0, 0.1, 0.3, 0.5), 0.3, "%", 100.0),  # share of the force of every column
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Variant:
    """A controller with its gains.

    Attributes:
        label: under which it stands in tables and figures.
        controller: name on the command line.
        gains: all that are numbers, as numbers or lists.
    """

    label: str
    controller: str
    gains: Mapping[str, Any]

    def changed(self, label: str, **gains: Any) -> Variant:
        """The same controller with some gains replaced."""
        return dataclasses.replace(self, label=label, gains={**self.gains, **gains})


Cast = Mapping[str, Variant]  # all variants by label


def by_hand(name: str) -> str:
    """The label of a controller with hand-set gains."""
    return f"{name}, hand-set"


def cast(folder: Path | None = None) -> Cast:
    """Every controller with tuned and with hand-set gains, and the ablations.

    Args:
        folder: of gain sets NAME.toml to take instead of those shipped; a controller without one
            has its hand-set gains.

    Raises:
        OctarmError: if a gain set cannot be read.
    """

    def variant(label: str, name: str, gain_set: str | Path | None) -> Variant:
        controller = make_controller(name, nominal_parameters(), gain_set=gain_set)
        gains = {gain: _plain(value) for gain, value in gains_of(controller).items()}
        return Variant(label=label, controller=name, gains=gains)

    def tuned(name: str) -> str | Path | None:
        file = None if folder is None else folder / f"{name}.toml"
        return file if file is None or file.is_file() else "recommended"

    variants = [
        *(variant(name, name, tuned(name)) for name in CONTROLLERS),
        *(variant(by_hand(name), name, "recommended") for name in CONTROLLERS),
    ]
    by_label = {variant.label: variant for variant in variants}
    proposed = by_label[PROPOSED]
    ablations = (
        proposed.changed(FIXED_PREMISES, eta3=0.0, eta4=0.0),
        proposed.changed(AS_PRINTED, phi=0.0),
        proposed.changed(UNGUARDED, safeguards=0.0),
        by_label[SMC].changed(MATCHED, **matched_slope(proposed.gains)),
    )
    return by_label | {variant.label: variant for variant in ablations}


def matched_slope(gains: Mapping[str, Any]) -> dict[str, Any]:
    """Gains of `smc-boundary` that give no less and no more than the bounds of `afsmc` allow.

    With E and all theta at their bounds, theta of each rule with the sign of its centre, and the
    premises as they start, the force of `afsmc` without K_v s is

        E_max sat(s / phi) + theta_max f(s / scale),
        f(z) = sum_l sgn(alpha_l) exp(-(sigma_l (z - alpha_l))^2)

    K and phi are such that that of `smc-boundary` has the same slope at s = 0 and the same largest
    value; lambda and K_v are the same anyway. What then is left between the two is adaptation, not
    gain.
    """
    alpha, sigma, phi, scale, E_max, theta_max = (
        np.atleast_1d(gains[name])
        for name in ("alpha0", "sigma0", "phi", "scale", "E_max", "theta_max")
    )
    bells = np.sign(alpha) * np.exp(-np.square(sigma * alpha))
    steepness = np.sum(2.0 * sigma * sigma * alpha * bells)
    slope = E_max / phi + theta_max * steepness / scale
    z = np.linspace(0.0, 3.0, 3001)[:, None]
    f = np.sum(np.sign(alpha) * np.exp(-np.square(sigma * (z - alpha))), axis=-1, keepdims=True)
    K = np.max(E_max * np.minimum(z * scale / phi, 1.0) + theta_max * f, axis=0)
    same = {name: gains[name] for name in ("lambda", "K_v")}
    return {**same, "K": _plain(K), "phi": _plain(K / slope)}


def _plain(gain: np.ndarray) -> Any:
    """A number where all are the same, else a list."""
    values = np.unique(gain)
    return values.item() if values.size == 1 else np.asarray(gain).tolist()


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
        cells = np.prod([len(axis.values) for axis in self.spec.axes])
        return float(self.spec.episodes * cells * self.spec.duration)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Effort:
    """How much is run: all of it, or a small part with the same rules.

    Attributes:
        name: `full` or `quick`.
        seeds: in each cell with noise.
        short: duration of the series of figures 1 and 2 and of the runs of Lyapunov functions [s].
        long: of the series that show drift, none if 0 [s].
        mismatches: of the nominal models in the main study without noise [1].
        rates: at which control is tried, apart from the default of 2 kHz [Hz].
        times: correlation times of the noise that are tried, apart from 10 ms [s].
        noises: of the degradation curve [1].
        complete: whether there are all controllers and studies, or those alone that verdicts need.
        series: the variants of figures 1 and 2.
        references: of figures 1 and 2.
        lyapunov: the variants whose Lyapunov functions are followed.
        sweeps: by folder: study, variants, and what else the spec says.
    """

    name: str
    seeds: int
    short: float
    long: float
    mismatches: list[float]
    rates: list[float]
    times: list[float]
    noises: list[float]
    complete: bool
    series: list[str]
    references: list[str]
    lyapunov: list[str]
    sweeps: Mapping[str, Mapping[str, Any]] = dataclasses.field(repr=False)

    @classmethod
    def read(cls, name: str) -> Effort:
        """That of `full.toml` or `quick.toml`."""
        text = importlib.resources.files("paper").joinpath(f"{name}.toml").read_text("utf-8")
        return cls(name=name, **tomllib.loads(text))

    def parts(self, variants: Cast) -> list[Part]:
        """All sweeps, with the gains of their variants.

        Raises:
            OctarmError: if one is not a valid spec.
        """
        return [_part(name, table, variants) for name, table in self.sweeps.items()]


FULL, QUICK = Effort.read("full"), Effort.read("quick")


def study_of_rate(rate: float) -> str:
    """The study at a control rate [Hz]; the default one is that of the main study."""
    return "tracking" if rate == RATE else f"rate-{rate:g}"


def _part(name: str, table: Mapping[str, Any], variants: Cast) -> Part:
    spec = dict(table)
    study, members = spec.pop("study"), [variants[label] for label in spec.pop("variants")]
    spec["seed"] = SEED
    spec["grid"] = {"controller": [member.controller for member in members], **spec["grid"]}
    spec["gains"] = {member.controller: dict(member.gains) for member in members}
    labels = {member.controller: member.label for member in members}
    return Part(study, name, parse_spec(tomlkit.dumps(spec), name), labels)

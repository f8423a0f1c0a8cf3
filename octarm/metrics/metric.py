"""The declaration of a metric, and the accumulator, which declares metrics and computes them."""

from __future__ import annotations

import abc
import dataclasses
import math
from collections.abc import Mapping
from typing import ClassVar, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from octarm.errors import OctarmError
from octarm.formats import Array
from octarm.interfaces import Rows

SETTLED_AFTER = 2.0  # [s]; the steady regime is the rest of the run, unless another one is given
STEADY = "in the steady regime"

POSITION, FORCE = ("m", "rad"), ("N", "N m")  # units of what slides and bends have

SLIDE_BAND = 1e-3  # [m]; an error within it counts as settled
BEND_BAND = 0.02  # [rad]
CORNER = 50.0  # [Hz]; twice the arm's highest mode (24.5 Hz) and far above its references


class Metric(NamedTuple):
    """The declaration of a metric, from which tables, reports and pages take what they say of it.

    Attributes:
        of: there is one number for each `coordinate`, for each `input`, a column of eq (2), or one
            for the `arm`.
        units: of the numbers of slides and of bends, or one for all; `1` for a share.
        text: its meaning, in one line.
        zero_best: whether the value nearest to zero is the best one.
        together: how the numbers of several inputs become one: root mean square, largest, or mean.
        waits_for: name of the metric that has a value whenever this one was to be expected. Where
            this one has none then, the event that it times never came.
    """

    of: Literal["coordinate", "input", "arm"]
    units: Array[str]
    text: str
    better: Literal["less", "more", "neither"] = "less"
    zero_best: bool = False
    together: Literal["rms", "max", "mean"] = "mean"
    waits_for: str = ""

    def unit_for(self, coordinate_unit: str = "m") -> str:
        """The unit of the number of a coordinate whose own unit is `m` or `rad`."""
        return self.units[-1] if coordinate_unit == "rad" else self.units[0]

    @property
    def sign(self) -> int:
        """1 when less is better, -1 when more is, 0 when neither."""
        return {"less": 1, "more": -1, "neither": 0}[self.better]

    @property
    def direction(self) -> str:
        """Which values are better, in words."""
        return "nearer to zero" if self.zero_best else self.better


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Settings:
    """What metrics need to know besides the rows of a run.

    Attributes:
        control_period: time between two control instants [s].
        steps: number of physics steps in it.
        input_range: lowest and highest tau, each broadcasts to (..., 2N) [N].
        layer: half width of the boundary layer, broadcasts to (..., 2N) [m/s], [rad/s], or None.
        band: |q - q_d| within it counts as settled, broadcasts to (..., 2N) [m], [rad]; if None,
            `SLIDE_BAND` of slides and `BEND_BAND` of bends.
        corner: of the high-pass filter of `chattering` [Hz].
        settle: when the steady regime begins [s].

    Raises OctarmError if the input range does not hold 0, or another one of them is not finite and
    positive (layer, settle: negative).
    """

    control_period: float
    steps: int = 1
    input_range: tuple[npt.ArrayLike, npt.ArrayLike] = (-math.inf, math.inf)
    layer: npt.ArrayLike | None = None
    band: npt.ArrayLike | None = None
    corner: float = CORNER
    settle: float = SETTLED_AFTER

    def __post_init__(self) -> None:
        low, high = self.input_range
        if not (np.all(np.asarray(low) <= 0.0) and np.all(np.asarray(high) >= 0.0)):
            raise OctarmError(f"input range is {self.input_range}; it must hold 0")
        for name, value in vars(self).items():
            if name in ("input_range", "steps"):
                continue
            array = np.asarray(1.0 if value is None else value, dtype=np.float64)
            least = 0.0 if name in ("layer", "settle") else np.finfo(float).tiny
            if not np.all(good := (array >= least) & np.isfinite(array)):
                allowed = "above 0" if least else "at least 0"
                bad = f"{name.replace('_', ' ')} holds {array[~good].flat[0]:g}"
                raise OctarmError(f"{bad}; it must be {allowed} and finite")

    @property
    def step(self) -> float:
        """Physics step [s]."""
        return self.control_period / self.steps

    def band_of(self, coordinates: int) -> npt.ArrayLike:
        """The settling band, broadcasts to (..., coordinates) [m], [rad]."""
        default = np.repeat([SLIDE_BAND, BEND_BAND], coordinates // 2)
        return default if self.band is None else self.band


def unsettled(duration: float, settle: float, option: str = "--settle") -> str:
    """Why a run of this length [s] has few metrics, and what to do; empty if it has them all."""
    if duration > settle:
        return ""
    return (
        f"errors, chattering and what else is measured {STEADY} count from {settle:g} s on, and "
        f"{duration:g} s is too short to have them; {option} {0.2 * duration:.3g} lets them begin "
        "earlier"
    )


class Accumulator(abc.ABC):
    """Takes a run a few rows at a time, and gives the metrics that its class declares.

    There is a row for every physics step; for an accumulator that needs signals, which exist at
    control instants only, there is one for every control instant. Rows have the fields `t`, `q` and
    `q_d` of `octarm.interfaces.Rows`, `error` = q - q_d and `squared_error`, and

    - `tau`, the input forces that the arm received in the step, and `force`, the generalised force
      that they exert where the step begins;
    - `asked_tau` and `asked_force`, what the controller asked for and the loop held;
    - the signals named in `signals`.

    Each has shape (k, ..., 2N) but `t` and signals. The arrays are only read and never kept.
    Results must not depend on how the run is cut, see `octarm.metrics.rows`.

    Attributes:
        metrics: the metrics that it gives, by name.
        signals: names of the controller's signals that it needs; without them it is left out.
    """

    metrics: ClassVar[Mapping[str, Metric]]
    signals: ClassVar[tuple[str, ...]] = ()

    @abc.abstractmethod
    def __init__(self, first: Rows, settings: Settings) -> None:
        """An accumulator for arms whose fields look like the first row's, each of shape (...)."""

    @abc.abstractmethod
    def update(self, rows: Rows, steady: bool) -> None:
        """Takes rows, and whether all of them are in the steady regime or none."""

    @abc.abstractmethod
    def result(self) -> dict[str, np.ndarray]:
        """The metrics so far, each of shape (..., 2N), or (...) for a metric of the arm."""


def asked(of: type[Accumulator], *names: str) -> type[Accumulator]:
    """An accumulator of what the controller asked for, made of one of what the arm received.

    It gives the metrics of these names, or all if none is named, as `asked_` and their name.
    """

    class Asked(Accumulator):
        metrics: ClassVar = {
            f"asked_{name}": metric._replace(text=f"{metric.text}, of what was asked for")
            for name, metric in of.metrics.items()
            if name in (names or of.metrics)
        }

        def __init__(self, first: Rows, settings: Settings) -> None:
            self._of = of(first, settings)

        def update(self, rows: Rows, steady: bool) -> None:
            forces = {"tau": rows["asked_tau"], "force": rows["asked_force"]}
            self._of.update({**rows, **forces}, steady)

        def result(self) -> dict[str, np.ndarray]:
            results = self._of.result()
            return {name: results[name.removeprefix("asked_")] for name in self.metrics}

    return Asked

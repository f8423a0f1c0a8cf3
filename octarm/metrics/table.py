"""Measures of a run, streaming: `update` with a block of control instants, `result` at the end.

No trajectory is held. Results do not depend on how the run is cut into blocks, and are the same
for an arm alone and as a row of a batch, bit for bit.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from octarm.errors import OctarmError
from octarm.interfaces import Rows
from octarm.metrics.blocks import SETTLED_AFTER as SETTLED_AFTER
from octarm.metrics.blocks import Block as Block
from octarm.metrics.blocks import parts
from octarm.metrics.chattering import CORNER, Chattering
from octarm.metrics.inputs import ForceUse, InputUse
from octarm.metrics.sliding import Sliding
from octarm.metrics.tracking import DWELL, Overshoot, Settling, TipError, TrackingError
from octarm.metrics.tracking import default_band as default_band

_NUMBERS_A_PART = 50_000  # of a coordinate array; more at a time would leave the caches


class Meaning(NamedTuple):
    """What a metric is.

    Attributes:
        of: what there is a number for: each `coordinate` s1 .. thetaN, each `input`, a column of
            eq (2), or each `arm`.
        slide_unit: unit for slides, inputs or arms.
        bend_unit: unit for bends.
        text: one line.
    """

    of: Literal["coordinate", "input", "arm"]
    slide_unit: str
    bend_unit: str
    text: str


_STEADY = f"after {SETTLED_AFTER:g} s"

METRICS: Mapping[str, Meaning] = {
    "rms_error": Meaning("coordinate", "m", "rad", f"root mean square of q - q_d {_STEADY}"),
    "peak_error": Meaning("coordinate", "m", "rad", f"largest |q - q_d| {_STEADY}"),
    "steady_error": Meaning("coordinate", "m", "rad", f"mean of q - q_d {_STEADY}, signed"),
    "overshoot": Meaning(
        "coordinate", "%", "%", f"by how much q exceeds the reference's swing {_STEADY}, signed"
    ),
    "undershoot": Meaning(
        "coordinate", "%", "%", "the same at the end of the swing where q exceeds it least"
    ),
    "step_overshoot": Meaning(
        "coordinate", "%", "%", "by how much q goes beyond a step, in percent of it"
    ),
    "settling_time": Meaning(
        "coordinate", "s", "s", f"when |q - q_d| is within its band for good, {DWELL:g} s at least"
    ),
    "settled": Meaning("coordinate", "1", "1", "1 if there is a settling time, else 0"),
    "tip_rms_error": Meaning("arm", "m", "", f"root mean square distance of the tips {_STEADY}"),
    "tip_peak_error": Meaning("arm", "m", "", f"largest distance of the tips {_STEADY}"),
    "effort": Meaning("input", "N", "", "root mean square of the input forces"),
    "peak_input": Meaning("input", "N", "", "largest absolute input force"),
    "saturation_share": Meaning("input", "1", "", "share of periods at the input limit"),
    "force_effort": Meaning("coordinate", "N", "N m", "root mean square of Q"),
    "energy": Meaning("coordinate", "J", "J", "integral of |Q_j q_j'|"),
    "work": Meaning("coordinate", "J", "J", "integral of Q_j q_j'"),
    "chattering": Meaning(
        "coordinate", "N", "N m", f"high-pass root mean square of Q {_STEADY}, any control rate"
    ),
    "total_variation": Meaning(
        "coordinate", "N/s", "N m/s", f"sum |dQ| a second {_STEADY}, at one control rate"
    ),
    "switching_activity": Meaning(
        "coordinate", "N", "N m", f"mean |dQ| a control period {_STEADY}, at one control rate"
    ),
    "control_rate": Meaning("arm", "Hz", "", "control instants a second"),
    "reaching_time": Meaning("coordinate", "s", "s", "when s first enters its layer"),
    "reaching_bound": Meaning(
        "arm", "s", "", "what the controller promised for s = 0 at the start"
    ),
    "layer_share": Meaning("coordinate", "1", "1", f"share of time with |s| <= phi {_STEADY}"),
    "sliding_violations": Meaning(
        "coordinate", "1", "1", "share of periods outside the layer over which |s| grew"
    ),
}


class Metrics:
    """All that is measured of a run or of a batch of runs; `METRICS` says what.

    What is said of sliding is there only when the controller's signals hold `s` (`layer_share` only
    with phi, too), and `reaching_bound` only when they hold it.
    """

    def __init__(
        self,
        *,
        control_period: float,
        input_limit: npt.ArrayLike = math.inf,
        phi: npt.ArrayLike | None = None,
        layer: npt.ArrayLike | None = None,
        band: npt.ArrayLike | None = None,
        corner: float = CORNER,
    ) -> None:
        """Measures for arms of any number and batch shape.

        Args:
            control_period: time between two control instants [s].
            input_limit: bound on |tau|, broadcasts to (..., 2N) [N].
            phi: half width of the boundary layer, broadcasts to (..., 2N) [m/s], [rad/s]; zero
                where there is none.
            layer: the same as phi.
            band: |q - q_d| within it counts as settled, broadcasts to (..., 2N) [m], [rad];
                `default_band` when not given.
            corner: of what counts as chattering [Hz].

        Raises:
            ValueError: if one of them is not positive (phi: negative), or not finite (the input
                limit aside).
        """
        phi = phi if layer is None else layer
        self._settings = _Settings(control_period, input_limit, phi, band, corner)
        for name, value in zip(_Settings._fields, self._settings, strict=True):
            if value is not None:
                largest = math.inf if name == "input_limit" else np.finfo(float).max
                spoken = name.replace("_", " ")
                _check(spoken, value, zero_allowed=name == "phi", largest=largest)
        self._measures: _Measures | None = None

    def update(self, rows: Block | Rows) -> None:
        """Takes up the next control instants.

        Raises:
            ValueError: if a limit, phi or the band does not fit the arms.
        """
        block = rows if isinstance(rows, Block) else Block.of(rows)
        if len(block.t) == 0:
            return
        if self._measures is None:
            self._measures = _Measures(block, self._settings)
        count = max(1, _NUMBERS_A_PART // block.q[0].size)
        with np.errstate(all="ignore"):  # a diverged arm may hold anything
            for part, steady in parts(block, count):
                self._measures.update(part, steady)

    def result(self, diverged: npt.ArrayLike = False) -> dict[str, np.ndarray]:
        """The measures so far, each of shape (..., 2N), or (...) for what there is one an arm.

        Args:
            diverged: which arms diverged, broadcasts to the batch shape. Their measures are NaN,
                and so are those of arms whose q, Q or tau was not finite at any time.

        Raises:
            ValueError: if there was no control instant.
        """
        if self._measures is None:
            raise OctarmError("there is nothing to measure: no control instant was taken up")
        with np.errstate(all="ignore"):
            results = self._measures.result()
            lost = self._measures.unsound(results) | np.asarray(diverged, dtype=bool)
        return {
            name: np.where(lost if meaning.of == "arm" else lost[..., None], np.nan, results[name])
            for name, meaning in METRICS.items()
            if name in results
        }


class _Settings(NamedTuple):
    control_period: float
    input_limit: npt.ArrayLike
    phi: npt.ArrayLike | None
    band: npt.ArrayLike | None
    corner: float


class _Measures:
    """The accumulators, for arms like those of a first block."""

    def __init__(self, first: Block, settings: _Settings) -> None:
        q, force, signals = first.q[0], first.force[0], first.signals
        band = default_band(q.shape[-1] // 2) if settings.band is None else settings.band
        self._error, self._tip = TrackingError(q), TipError(q)
        self._settling = Settling(q, settings.control_period, band)
        self._overshoot = Overshoot(q, first.q_d[0], band)
        self._inputs = InputUse(first.tau[0], settings.input_limit)
        self._forces = ForceUse(force)
        self._chattering = Chattering(force, settings.control_period, settings.corner)
        self._sliding = Sliding(signals["s"][0], settings.phi) if "s" in signals else None
        # One for the arm, or one a coordinate: then s = 0 is promised for the last of them.
        bound = signals.get("reaching_bound")
        self._bound = None if bound is None else np.max(bound[0], axis=-1)

    def update(self, rows: Block, steady: bool) -> None:
        error = rows.q - rows.q_d
        squares = error * error
        self._settling.update(squares)
        self._overshoot.update(rows.q, rows.q_d, steady)
        self._inputs.update(rows.tau)
        self._forces.update(rows.q, rows.force)
        self._chattering.update(rows.force, steady)
        if self._sliding is not None:
            self._sliding.update(rows.t, rows.signals["s"], steady)
        if steady:
            self._error.update(error, squares)
            self._tip.update(rows.q, rows.q_d)

    def result(self) -> dict[str, np.ndarray]:
        tracking = self._error.result() | self._settling.result() | self._overshoot.result()
        cost = self._inputs.result() | self._forces.result() | self._chattering.result()
        results = tracking | self._tip.result() | cost
        if self._sliding is not None:
            results |= self._sliding.result()
        if self._bound is not None:
            results["reaching_bound"] = self._bound
        return results

    def unsound(self, results: Mapping[str, np.ndarray]) -> np.ndarray:
        """Which arms held something that was not finite or too large to square, shape (...)."""
        largest, smallest = self._overshoot.reached()
        seen = results["effort"] + results["force_effort"] + results["energy"]
        lost = np.isinf(results["rms_error"]) | ~np.isfinite(seen + (largest - smallest))
        return np.any(lost, axis=-1)


def _check(name: str, value: npt.ArrayLike, *, zero_allowed: bool, largest: float) -> None:
    array = np.asarray(value, dtype=np.float64)
    good = ((array >= 0.0) if zero_allowed else (array > 0.0)) & (array <= largest)
    if not np.all(good):
        allowed = "at least 0" if zero_allowed else "above 0"
        finite = " and finite" if math.isfinite(largest) else ""
        raise OctarmError(f"{name} holds {array[~good].flat[0]:g}; it must be {allowed}{finite}")

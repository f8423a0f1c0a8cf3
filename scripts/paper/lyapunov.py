"""The Lyapunov functions of the paper along sampled runs of the arm.

For the sliding modes V = 1/2 s^T D s, eq (32), with the true arm's D. For the adaptive law V is all
of eq (80). Its optima may be any that the proof can do with, and are set when the run is over:

    theta* = 0,  alpha* = alpha0,  sigma* = sigma0,  E*_j = sup |eps_j|,
    eps_j = F_j + (alpha_j - alpha0)^T B_j theta_j + (sigma_j - sigma0)^T C_j theta_j

F_j is the error of the model. Then V' = sum_j s_j eps_j - E*_j |s_j| - s^T (B + K_v) s <= 0 in
continuous time, with sgn(s), and without safeguards. What is counted is how often V is larger at a
control instant than at the one before.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from octarm import load
from octarm.arm.lagrange import inverse_dynamics, kinetic_energy
from octarm.arm.mjcf import nominal_parameters
from octarm.files import write_text
from octarm.metrics.table import SETTLED_AFTER
from paper.runs import record
from paper.studies import BENDS, MODELS, RATE, Cast, Effort, Variant

_FIELDS = ("q", "v", "v_d", "s", "E", "theta", "alpha", "sigma")


class Outcome(NamedTuple):
    """How V went on one arm.

    Attributes:
        label: of the variant.
        rate: of control [Hz].
        mismatch: of the nominal model [1].
        covered: whether the switching gain covers the model error, K_j >= |F_j|, at all times; of
            the adaptive law whether E_max covers eps.
        outside: periods that begin outside the boundary layer: |s_j| > phi_j for a j.
        grown_outside: of them, those over which V grew.
        inside: periods that begin within it.
        grown_inside: of them, those over which V grew.
        start: V at the start [J].
        bound: largest 1/2 s^T D s in the steady regime [J].
        diverged: whether the arm left its limits.
    """

    label: str
    rate: float
    mismatch: float
    covered: bool
    outside: int
    grown_outside: int
    inside: int
    grown_inside: int
    start: float
    bound: float
    diverged: bool

    @property
    def share_outside(self) -> float:
        """Share of the periods outside the layer over which V grew; 0 without such periods [1]."""
        return self.grown_outside / self.outside if self.outside else 0.0

    @property
    def share_inside(self) -> float:
        """Likewise of those inside [1]."""
        return self.grown_inside / self.inside if self.inside else 0.0


class LyapunovRequest(NamedTuple):
    """Arms of one variant without noise, one for each of `MODELS`, at one control rate.

    Attributes:
        variant: what controls them.
        rate: of control [Hz].
        duration: [s].
    """

    variant: Variant
    rate: float
    duration: float

    @property
    def seconds(self) -> float:
        """What is simulated, all arms counted [s]."""
        return len(MODELS) * self.duration

    def file(self, out: Path) -> Path:
        """Where the outcomes stand."""
        name = self.variant.label.replace(", ", "-")
        return out / "stability" / f"{name}-{self.rate:g}-Hz.json"

    def run(self) -> list[Outcome]:
        """Runs the arms."""
        period = 1.0 / self.rate
        environment = load(
            BENDS, batch=len(MODELS), control_period=period, timestep=min(period, 1.0 / RATE)
        )
        rows = record(environment, self.variant, np.array(MODELS), self.duration, _FIELDS)
        with np.errstate(all="ignore"):  # of arms that are lost
            rows["F"] = _model_error(rows, np.asarray(self.variant.gains["lambda"]))
            rows["D"] = kinetic_energy(nominal_parameters(), rows["q"], rows["s"])
            columns = {
                name: rows[name] for name in (*_FIELDS[3:], "F", "D", "intact") if name in rows
            }
            arms = [{name: x[:, i] for name, x in columns.items()} for i in range(len(MODELS))]
            return [self._outcome(m, arm) for m, arm in zip(MODELS, arms, strict=True)]

    def write(self, out: Path) -> None:
        """Writes the outcomes as JSON."""
        text = json.dumps([outcome._asdict() for outcome in self.run()], indent=1)
        write_text(self.file(out), text + "\n")

    def read(self, out: Path) -> list[Outcome]:
        """What `write` wrote."""
        return [Outcome(**row) for row in json.loads(self.file(out).read_text("utf-8"))]

    def _outcome(self, mismatch: float, arm: Mapping[str, np.ndarray]) -> Outcome:
        """How V went, from the rows of an arm: `D` is 1/2 s^T D s [J], `F` the model error."""
        gains, s = self.variant.gains, arm["s"]
        if "E" in arm:
            more, covered = _adapted(gains, arm)
        else:
            needed = np.max(np.abs(arm["F"]), axis=0)
            more, covered = 0.0, bool(np.all(needed <= np.asarray(gains.get("K", 0.0))))
        V = arm["D"] + more
        grown = V[1:] > V[:-1]
        outside = np.any(np.abs(s[:-1]) > np.asarray(gains.get("phi", 0.0)), axis=-1)
        return Outcome(
            label=self.variant.label,
            rate=self.rate,
            mismatch=mismatch,
            covered=covered,
            outside=int(outside.sum()),
            grown_outside=int((outside & grown).sum()),
            inside=int((~outside).sum()),
            grown_inside=int((~outside & grown).sum()),
            start=float(V[0]),
            bound=float(np.max(arm["D"][round(SETTLED_AFTER * self.rate) :], initial=0.0)),
            diverged=not arm["intact"][-1],
        )


def lyapunov_requests(variants: Cast, effort: Effort) -> list[LyapunovRequest]:
    """The sliding modes with hand-set gains, which are above the model error; `afsmc` with both."""
    rates = sorted({*effort.rates, RATE})
    return [
        LyapunovRequest(variants[label], rate, effort.short)
        for label in effort.lyapunov
        for rate in rates
    ]


def _model_error(rows: Mapping[str, np.ndarray], lambda_: np.ndarray) -> np.ndarray:
    """F = (D^ - D) q_r'' + .. + G^ - G, shape (T, n, 2N) [N], [N m]."""
    true, v = nominal_parameters(), rows["v"]
    v_r, a_r = v - rows["s"], rows["a_d"] - lambda_ * (v - rows["v_d"])
    nominal = true.mismatched(np.array(MODELS))
    return inverse_dynamics(nominal, rows["q"], v, a_r, v_r) - inverse_dynamics(
        true, rows["q"], v, a_r, v_r
    )


def _adapted(gains: Mapping[str, Any], arm: Mapping[str, np.ndarray]) -> tuple[np.ndarray, bool]:
    """The part of V, eq (80), beyond the first term, shape (T,) [J]; whether E_max covers eps."""
    theta, alpha, sigma, E = (arm[name] for name in ("theta", "alpha", "sigma", "E"))
    z = (arm["s"] / np.asarray(gains["scale"]))[..., None]
    alpha0, sigma0 = np.asarray(gains["alpha0"]), np.asarray(gains["sigma0"])
    phi = np.exp(-np.square(sigma * (z - alpha)))
    by_alpha, by_sigma = 2.0 * sigma**2 * (z - alpha) * phi, -2.0 * sigma * (z - alpha) ** 2 * phi
    moved = (alpha - alpha0) * by_alpha + (sigma - sigma0) * by_sigma
    eps = arm["F"] + np.sum(moved * theta, axis=-1)
    needed = np.max(np.abs(eps), axis=0)
    rules = sum(
        np.sum(np.square(x), axis=-1) / np.maximum(np.asarray(gains[eta]), 1e-300)
        for x, eta in ((theta, "eta2"), (alpha - alpha0, "eta3"), (sigma - sigma0, "eta4"))
    )
    energy = np.square(needed - E) / np.asarray(gains["eta1"]) + rules
    return 0.5 * np.sum(energy, axis=-1), bool(np.all(needed <= np.asarray(gains["E_max"])))

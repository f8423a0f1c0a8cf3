"""The Lyapunov ledger: the controllers' proofs of stability, checked at random states, as a report.

Every right law has to give V' as claimed, and never above its bound; every wrong one, made from the
right one by a misprint of the paper, has to be noticed by the same comparison. The bounds leave
out what the dampers and K_v take, which must not make up for what a law lacks.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np

from controllers import make_controller
from controllers.fuzzy_rules import FuzzySlidingMode
from controllers.proofs import lyapunov
from controllers.proofs.adaptive_ledger import adaptive, misprints
from controllers.sliding_mode import IntegralState, Surface
from controllers.super_twisting import SuperTwistingState
from octarm.arm.parameters import ArmParameters
from octarm.errors import OctarmError
from octarm.tolerances import Check, CheckTable, run_checks

FEWEST_STATES = 100


def ledger(
    parameters: ArmParameters,
    states: int = 3000,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> CheckTable:
    """Checks the controllers' Lyapunov functions on an arm.

    It is the true arm; the controllers are given random nominal models at so many random states for
    each comparison. Raises OctarmError if `states` is below 100.
    """
    if states < FEWEST_STATES:
        raise OctarmError(
            f"the number of states is {states}; the controllers need at least {FEWEST_STATES}"
        )
    rng = np.random.default_rng(seed)
    randomly = parameters, states, rng
    parts = {
        "sliding mode": _sliding_mode(*randomly),
        "boundary layer": _boundary_layers(*randomly),
        "integral surface": _integral_surface(*randomly),
        "super-twisting": _super_twisting(*randomly),
        "adaptive fuzzy": adaptive(*randomly),
        "misprints": misprints(*randomly),
    }
    checks = run_checks(parts, progress)
    n = parameters.modules
    title = (
        f"Controllers against their Lyapunov functions: {n} module{'s' if n > 1 else ''}, "
        f"{states} states, seed {seed}; V' as a share of its rms"
    )
    return CheckTable(title, parameters.to_dict(), states, seed, checks)


class _Trial(NamedTuple):
    """Random instants with a switching gain that covers the model error there, eq (40)."""

    at: lyapunov.Instants
    surface: Surface
    F: np.ndarray  # model error, shape (n, 2N) [N], [N m]
    eta: np.ndarray  # margin of the gain, shape (2N,) [N], [N m]
    K: np.ndarray  # |F| + eta
    K_v: np.ndarray  # linear gain, shape (2N,)

    def answer(self, name: str, state: Any = None, **gains: Any) -> tuple[np.ndarray, Any]:
        """The force of the shipped controller of this name, shape (n, 2N), and its next state."""
        given = {"lambda": lyapunov.LAMBDA, "K": self.K, "K_v": self.K_v} | gains
        controller = make_controller(name, self.at.nominal, given)
        command, after = controller(state, self.at.measurement, self.at.reference)
        return command.force, after

    def rate(self, force: np.ndarray) -> np.ndarray:
        """V' by the chain rule through the true arm, shape (n,) [W]."""
        return lyapunov.energy_rate(self.at, self.surface, force)

    def claim(self, robust: np.ndarray) -> np.ndarray:
        """V' = s^T (F + robust part) - s^T (K_v + B) s, eq (38), shape (n,) [W]."""
        return np.sum(self.surface.s * (self.F + robust), axis=-1) - self.taken

    @property
    def reaching(self) -> np.ndarray:
        """-sum eta |s| - s^T (K_v + B) s, eq (42), shape (n,) [W]."""
        return -np.sum(self.eta * np.abs(self.surface.s), axis=-1) - self.taken

    @property
    def taken(self) -> np.ndarray:
        """s^T (K_v + B) s, what the linear gain and the dampers take, shape (n,) [W]."""
        return lyapunov.damped(self.at, self.surface.s, self.K_v)

    def within(self, phi: np.ndarray) -> np.ndarray:
        """The bound (42) with a boundary layer: sum K phi / 4 more, shape (n,) [W]."""
        return self.reaching + np.sum(0.25 * self.K * phi, axis=-1)


def _trial(
    p: ArmParameters,
    states: int,
    rng: np.random.Generator,
    surface_of: Callable[[lyapunov.Instants], Surface] = lyapunov.sliding,
) -> _Trial:
    at = lyapunov.random_instants(p, states, rng)
    surface = surface_of(at)
    F = lyapunov.model_error(at, surface)
    eta = 0.01 * np.sqrt(np.mean(F * F, axis=0))
    return _Trial(at, surface, F, eta, np.abs(F) + eta, lyapunov.linear_gain_of(p))


def _sliding_mode(p: ArmParameters, states: int, rng: np.random.Generator) -> Iterator[Check]:
    """V' = s^T F - sum K |s| - s^T (K_v + B) s <= -sum eta |s| - s^T (K_v + B) s, (38)-(42)."""
    t = _trial(p, states, rng)
    robust = -t.K * np.sign(t.surface.s)
    force, _ = t.answer("smc")
    rate, claim = t.rate(force), t.claim(robust)
    yield from lyapunov.proved("smc", rate, claim, t.reaching)
    yield lyapunov.noticed("+K sgn(s) as in (31)", t.rate(force - 2.0 * robust), claim)


def _boundary_layers(p: ArmParameters, states: int, rng: np.random.Generator) -> Iterator[Check]:
    """V' = s^T F - sum K s f(s / phi) - s^T (K_v + B) s, at most (42) + sum K phi / 4.

    f is a saturation, or fuzzy: on the far side of sat(s / phi) from zero it pushes back at least
    as hard.
    """
    phi = lyapunov.layer_of(p)
    t = _trial(p, states, rng)
    rate = t.rate(t.answer("fsmc", phi=phi)[0])
    claim = t.claim(-t.K * FuzzySlidingMode.fuzzy(t.surface.s / phi))
    yield from lyapunov.proved("fsmc", rate, claim, t.within(phi))
    t = _trial(p, states, rng)
    rate = t.rate(t.answer("smc-boundary", phi=phi)[0])
    claim = t.claim(-t.K * np.clip(t.surface.s / phi, -1.0, 1.0))
    yield from lyapunov.proved("smc-boundary", rate, claim, t.within(phi))
    inside = np.all(np.abs(t.surface.s) < phi, axis=-1)
    rising = float(np.mean(rate[inside] > 0.0))
    yield Check("smc-boundary inside the layer: share of V' > 0", rising, 1.0, 1e-3)


def _integral_surface(p: ArmParameters, states: int, rng: np.random.Generator) -> Iterator[Check]:
    """The same theorem on the surface (24), corrected, whose q_r' holds the integral of e."""
    t = _trial(p, states, rng, lyapunov.integral_sliding)
    state = IntegralState(t.at.measurement.t - 1.0, t.at.integral.copy())
    force, after = t.answer("smc-integral", state, phi=0.0, s_max=1e3)
    # The chain rule takes the rate at which the controller integrates, over its step of 1 s.
    integrated = after.integral - t.at.integral
    actual = t.surface.a_r - lyapunov.LAMBDA**2 * (integrated - t.at.errors[0])
    rate = lyapunov.energy_rate(t.at, t.surface._replace(a_r=actual), force)
    claim = t.claim(-t.K * np.sign(t.surface.s))
    yield from lyapunov.proved("smc-integral", rate, claim, t.reaching)


def _super_twisting(p: ArmParameters, states: int, rng: np.random.Generator) -> Iterator[Check]:
    """V' + s^T (K_v + B) s = s^T (F + w) - sum k_1 |s|^(3/2) <= sum 4 |F + w|^3 / (27 k_1^2).

    A bounded V is all that follows for this arm: the function that proves convergence in finite
    time takes one coordinate with a constant mass.
    """
    t = _trial(p, states, rng)
    size = np.abs(t.surface.s)
    w = t.K * rng.uniform(-1.0, 1.0, t.K.shape)
    # A root gain that balances the model error somewhere among these |s|.
    k_1 = np.sqrt(np.mean(t.F * t.F, axis=0) / lyapunov.layer_of(p))
    state = SuperTwistingState(t.at.measurement.t, w.copy())
    rate = t.rate(t.answer("super-twisting", state, k_1=k_1)[0])
    claim = t.claim(w - k_1 * np.sqrt(size) * np.sign(t.surface.s))
    bound = np.sum(4.0 * np.abs(t.F + w) ** 3 / (27.0 * k_1**2), axis=-1)
    yield from lyapunov.proved("super-twisting", rate, claim, bound - t.taken)

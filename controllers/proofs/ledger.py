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
from controllers.integral_sliding_mode import IntegralState
from controllers.proofs.adaptive_ledger import (
    AdaptiveTrial,
    adaptive,
    adaptive_trial,
    along_a_run,
    etas,
    membership,
    membership_along,
)
from controllers.proofs.lyapunov import (
    LAMBDA,
    Instants,
    as_claimed,
    below,
    damped,
    energy_rate,
    integral_sliding,
    layer_of,
    linear_gain_of,
    model_error,
    noticed,
    proved,
    random_instants,
    rms,
    sliding,
)
from controllers.sliding_mode import Surface
from controllers.super_twisting import SuperTwistingState
from octarm.arm.lagrange import coriolis_matrix
from octarm.arm.parameters import ArmParameters
from octarm.errors import OctarmError
from octarm.tolerances import Check, CheckTable, run_checks

FEWEST_STATES = 100
UNCERTAINTY = 0.3  # share by which a nominal model may be off when K is derived


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
        "derived gain": _derived_gain(*randomly),
        "boundary layer": _boundary_layers(*randomly),
        "integral surface": _integral_surface(*randomly),
        "super-twisting": _super_twisting(*randomly),
        "adaptive fuzzy": adaptive(*randomly),
        "misprints": misprints(*randomly),
        "a run": along_a_run(parameters, rng),
    }
    checks = run_checks(parts, progress)
    n = parameters.modules
    title = (
        f"Controllers against their Lyapunov functions: {n} module{'s' if n > 1 else ''}, "
        f"{states} states, seed {seed}; V' as a share of its rms"
    )
    return CheckTable(title, parameters.to_dict(), states, seed, checks)


class SwitchingTrial(NamedTuple):
    """Random instants with a switching gain that covers the model error there, eq (40).

    Attributes:
        at: the instants.
        surface: s and what follows from it.
        F: model error, shape (n, 2N) [N], [N m].
        eta: margin of the gain, shape (2N,) [N], [N m].
        K: |F| + eta, shape (n, 2N) [N], [N m].
        K_v: linear gain, shape (2N,).
    """

    at: Instants
    surface: Surface
    F: np.ndarray
    eta: np.ndarray
    K: np.ndarray
    K_v: np.ndarray

    def answer(self, name: str, state: Any = None, **gains: Any) -> tuple[np.ndarray, Any]:
        """The force of the shipped controller of this name, shape (n, 2N), and its next state."""
        given = {"lambda": LAMBDA, "K": self.K, "K_v": self.K_v} | gains
        controller = make_controller(name, self.at.nominal, given)
        command, after = controller(state, self.at.measurement, self.at.reference)
        return command.force, after

    def rate(self, force: np.ndarray) -> np.ndarray:
        """V' by the chain rule through the true arm, shape (n,) [W]."""
        return energy_rate(self.at, self.surface, force)

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
        return damped(self.at, self.surface.s, self.K_v)

    def within(self, phi: np.ndarray) -> np.ndarray:
        """The bound (42) with a boundary layer: sum K phi / 4 more, shape (n,) [W]."""
        return self.reaching + np.sum(0.25 * self.K * phi, axis=-1)


def _trial(at: Instants, surface: Surface) -> SwitchingTrial:
    F = model_error(at, surface)
    eta = 0.01 * np.sqrt(np.mean(F * F, axis=0))
    return SwitchingTrial(at, surface, F, eta, np.abs(F) + eta, linear_gain_of(at.true))


def _random_trial(p: ArmParameters, states: int, rng: np.random.Generator) -> SwitchingTrial:
    at = random_instants(p, states, rng)
    return _trial(at, sliding(at))


def _sliding_mode(p: ArmParameters, states: int, rng: np.random.Generator) -> Iterator[Check]:
    """V' = s^T F - sum K |s| - s^T (K_v + B) s <= -sum eta |s| - s^T (K_v + B) s, (38)-(42)."""
    t = _random_trial(p, states, rng)
    robust = -t.K * np.sign(t.surface.s)
    force, _ = t.answer("smc")
    rate, claim = t.rate(force), t.claim(robust)
    yield from proved("smc", rate, claim, t.reaching)
    yield noticed("+K sgn(s) as in (31)", t.rate(force - 2.0 * robust), claim)


def _derived_gain(p: ArmParameters, states: int, rng: np.random.Generator) -> Iterator[Check]:
    """V' <= -sum eta |s| - s^T (K_v + B) s for every model within the uncertainty, eq (40).

    At states with one s_j that is not zero, with the model that drives it outwards most: for such
    a model K is as large as it must be, and no larger.
    """
    at = random_instants(p, states, rng)
    only = rng.integers(p.coordinates, size=states)[:, None] == np.arange(p.coordinates)
    s = only * sliding(at).s
    v_d = at.measurement.v - s + LAMBDA * at.errors[0]
    at = at._replace(reference=at.reference._replace(v=v_d))
    at = at._replace(nominal=_worst_model(at, sliding(at)))
    t = _trial(at, sliding(at))
    gains = {"lambda": LAMBDA, "K_v": t.K_v, "uncertainty": UNCERTAINTY}
    controller: Any = make_controller("smc", at.nominal, gains)
    rate = t.rate(controller(None, at.measurement, at.reference)[0].force)
    bound = t._replace(eta=controller.eta).reaching
    yield below(f"smc, K from an uncertainty of {UNCERTAINTY:g}", rate, bound, rms(rate))


def _worst_model(at: Instants, surface: Surface) -> ArmParameters:
    """The model within the uncertainty that has the largest s^T F, one for each instant.

    F is linear in the parameters, so that each of them can be taken for itself.
    """
    factors: dict[str, np.ndarray] = {}
    for name, share in (("mass", 1.0), ("inertia", 1.0), ("damping", 1.0), ("stiffness", 0.5)):
        size = getattr(at.true, name).shape
        factors[name] = np.ones((*surface.s.shape[:-1], *size))
        for index in np.ndindex(size):
            twice = np.ones(size)
            twice[index] = 2.0
            F = model_error(at._replace(nominal=at.true.scaled(**{name: twice})), surface)
            power = np.sum(surface.s * F, axis=-1)
            factors[name][(..., *index)] += share * UNCERTAINTY * np.sign(power)
    return at.true.scaled(**factors)


def _boundary_layers(p: ArmParameters, states: int, rng: np.random.Generator) -> Iterator[Check]:
    """V' = s^T F - sum K s f(s / phi) - s^T (K_v + B) s, at most (42) + sum K phi / 4.

    f is a saturation, or fuzzy: on the far side of sat(s / phi) from zero it pushes back at least
    as hard.
    """
    phi = layer_of(p)
    t = _random_trial(p, states, rng)
    rate = t.rate(t.answer("fsmc", phi=phi)[0])
    claim = t.claim(-t.K * FuzzySlidingMode.fuzzy(t.surface.s / phi))
    yield from proved("fsmc", rate, claim, t.within(phi))
    t = _random_trial(p, states, rng)
    rate = t.rate(t.answer("smc-boundary", phi=phi)[0])
    claim = t.claim(-t.K * np.clip(t.surface.s / phi, -1.0, 1.0))
    yield from proved("smc-boundary", rate, claim, t.within(phi))
    inside = np.all(np.abs(t.surface.s) < phi, axis=-1)
    rising = float(np.mean(rate[inside] > 0.0))
    yield Check("smc-boundary inside the layer: share of V' > 0", rising, 1.0, 1e-3)


def _integral_surface(p: ArmParameters, states: int, rng: np.random.Generator) -> Iterator[Check]:
    """The same theorem on the surface (24), corrected, whose q_r' holds the integral of e."""
    at = random_instants(p, states, rng)
    t = _trial(at, integral_sliding(at))
    state = IntegralState(t.at.measurement.t - 1.0, t.at.integral.copy())
    force, after = t.answer("smc-integral", state, phi=0.0, s_max=1e3)
    # The chain rule takes the rate at which the controller integrates, over its step of 1 s.
    integrated = after.integral - t.at.integral
    actual = t.surface.a_r - LAMBDA**2 * (integrated - t.at.errors[0])
    rate = energy_rate(t.at, t.surface._replace(a_r=actual), force)
    claim = t.claim(-t.K * np.sign(t.surface.s))
    yield from proved("smc-integral", rate, claim, t.reaching)


def _super_twisting(p: ArmParameters, states: int, rng: np.random.Generator) -> Iterator[Check]:
    """V' + s^T (K_v + B) s = s^T (F + w) - sum k_1 |s|^(3/2) <= sum 4 |F + w|^3 / (27 k_1^2).

    A bounded V is all that follows for this arm: the function that proves convergence in finite
    time takes one coordinate with a constant mass.
    """
    t = _random_trial(p, states, rng)
    size = np.abs(t.surface.s)
    w = t.K * rng.uniform(-1.0, 1.0, t.K.shape)
    # A root gain that balances the model error somewhere among these |s|.
    k_1 = np.sqrt(np.mean(t.F * t.F, axis=0) / layer_of(p))
    state = SuperTwistingState(t.at.measurement.t, w.copy())
    rate = t.rate(t.answer("super-twisting", state, k_1=k_1)[0])
    claim = t.claim(w - k_1 * np.sqrt(size) * np.sign(t.surface.s))
    bound = np.sum(4.0 * np.abs(t.F + w) ** 3 / (27.0 * k_1**2), axis=-1)
    yield from proved("super-twisting", rate, claim, bound - t.taken)


def misprints(p: ArmParameters, states: int, rng: np.random.Generator) -> Iterator[Check]:
    """The rows of the paper's wrong variants, on an arm whose dampers do not hide them."""
    bare = p.scaled(damping=0.0)
    t = adaptive_trial("afsmc", bare, states, rng)
    yield noticed("C_j as printed, d/d alpha", printed_C(t).rate, t.claim)
    yield noticed("d/d delta moves sigma", delta_gradient(t).rate, t.claim)
    yield noticed("+ F^ + F_cp in (63)", added_estimate(t).rate, t.claim)
    if p.modules > 1:  # a single module has no Coriolis force
        yield noticed("C laid out as in (4)", paper_coriolis(t).rate, t.claim)
    yield as_claimed("afsmc, B_j, C_j laid out as in (72)", printed_layout(t).rate, t.claim)
    t = adaptive_trial("afsmc", bare, states, rng, normalised=True)
    yield noticed("the same, normalised", printed_layout(t).rate, t.claim)
    yield noticed("normalised as if sum mu = 1", as_if_sum_is_one(t).rate, t.claim)


def printed_C(t: AdaptiveTrial) -> AdaptiveTrial:
    """C_j as printed in (72): d/d alpha where d/d sigma is meant."""
    eta = etas(t.law)
    return _moving(t, sigma=eta.sigma / eta.alpha * t.rates.alpha)


def delta_gradient(t: AdaptiveTrial) -> AdaptiveTrial:
    """Sigma moved by the gradient in the delta of (59): d/d delta = -sigma^2 d/d sigma."""
    return _moving(t, sigma=-np.square(t.now.sigma) * t.rates.sigma)


def added_estimate(t: AdaptiveTrial) -> AdaptiveTrial:
    """(63) with + F^ + F_cp."""
    s = t.surface.s
    estimate = np.sum(t.now.theta * membership(t.law, s, t.now), axis=-1)  # eq (67)
    return t._replace(force=t.force + 2.0 * (estimate + t.now.E * np.sign(s)))


def paper_coriolis(t: AdaptiveTrial) -> AdaptiveTrial:
    """C laid out as in (4) in the law: for it, D' - 2C is not skew."""
    nominal, (_, q, v) = t.at.nominal, t.at.measurement
    change = layout_of_the_paper(nominal, q, v) - coriolis_matrix(nominal, q, v)
    return t._replace(force=t.force + np.einsum("...ij,...j->...i", change, t.surface.v_r))


def layout_of_the_paper(p: ArmParameters, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """A C with the right C q', and s_i' theta_j' whole in the column of s_i, (..., 2N, 2N)."""
    turning = v.copy()
    turning[..., : p.modules] = 0.0
    out = coriolis_matrix(p, q, turning)
    out[..., : p.modules] = 2.0 * coriolis_matrix(p, q, v)[..., : p.modules]
    return out


def printed_layout(t: AdaptiveTrial) -> AdaptiveTrial:
    """B_j and C_j laid out as in (72), the transpose: B theta in place of B^T theta."""
    eta, s, still = etas(t.law), t.surface.s, np.zeros_like(t.now.theta)
    B_theta = membership_along(t.law, s, t.now, t.now._replace(alpha=t.now.theta, sigma=still))
    C_theta = membership_along(t.law, s, t.now, t.now._replace(alpha=still, sigma=t.now.theta))
    s = s[..., None]
    return _moving(t, alpha=eta.alpha * s * B_theta, sigma=eta.sigma * s * C_theta)


def as_if_sum_is_one(t: AdaptiveTrial) -> AdaptiveTrial:
    """The gradients that (65) suggests: phi^l is divided by the sum, yet moves alone."""
    eta, s, (theta, alpha, sigma, _) = etas(t.law), t.surface.s[..., None], t.now
    away = s / np.asarray(t.law.scale)[..., None] - alpha
    slope = 2.0 * theta * membership(t.law, t.surface.s, t.now) * sigma * away
    return _moving(t, alpha=eta.alpha * s * slope * sigma, sigma=-eta.sigma * s * slope * away)


def _moving(t: AdaptiveTrial, **rates: np.ndarray) -> AdaptiveTrial:
    return t._replace(rates=t.rates._replace(**rates))

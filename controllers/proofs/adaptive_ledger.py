"""The theorem (80)-(87) of the adaptive controllers, and the paper's misprints of it.

Shapes: (...) for the batch, 2N coordinates, M fuzzy rules a coordinate. Energies in J, rates in W.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple, cast

import numpy as np

from controllers import AdaptiveConsequents, AdaptiveFuzzy, make_controller
from controllers.proofs import lyapunov
from controllers.sliding_mode import Surface
from octarm.arm.lagrange import coriolis_matrix
from octarm.arm.parameters import ArmParameters
from octarm.tolerances import Check

AdaptiveLaw = AdaptiveConsequents | AdaptiveFuzzy
RULES = 5


class Adapted(NamedTuple):
    """Values of all that an adaptive controller adapts; or their rates, per s.

    Attributes:
        theta: consequents, shape (..., 2N, M) [N], [N m].
        alpha: centres of the membership functions, shape (..., 2N, M), in units of z.
        sigma: their inverse widths, shape (..., 2N, M), in units of 1/z.
        E: gain of the compensation, shape (..., 2N) [N], [N m].
    """

    theta: np.ndarray
    alpha: np.ndarray
    sigma: np.ndarray
    E: np.ndarray


class _Trial(NamedTuple):
    """Instants with values of all that an adaptive controller adapts, and what it does there."""

    at: lyapunov.Instants
    law: AdaptiveLaw
    surface: Surface
    now: Adapted
    best: Adapted  # optimal values
    eps: np.ndarray  # error of the approximation, eq (73), shape (..., 2N) [N], [N m]
    force: np.ndarray  # what the controller answers, shape (..., 2N) [N], [N m]
    rates: Adapted  # how fast it adapts

    @property
    def taken(self) -> np.ndarray:
        """s^T (K_v + B) s, what the linear gain and the dampers take, shape (...)."""
        return lyapunov.damped(self.at, self.surface.s, self.law.K_v)

    @property
    def claim(self) -> np.ndarray:
        """V' = sum s eps - E* |s| - s^T (K_v + B) s, eq (85), shape (...)."""
        s = self.surface.s
        return np.sum(s * self.eps - self.best.E * np.abs(s), axis=-1) - self.taken

    @property
    def rate(self) -> np.ndarray:
        """V' by the chain rule through the true arm, eq (81) and x~' = -x', eq (84), (...)."""
        theta, alpha, sigma, E = (  # where eta is 0, nothing adapts and any weight does: 1
            x * y / np.where(eta == 0.0, 1.0, eta)
            for x, y, eta in zip(
                difference(self.best, self.now), self.rates, etas(self.law), strict=True
            )
        )
        learning = np.sum(E + np.sum(theta + alpha + sigma, axis=-1), axis=-1)
        return lyapunov.energy_rate(self.at, self.surface, self.force) - learning


def adaptive(p: ArmParameters, states: int, rng: np.random.Generator) -> Iterator[Check]:
    """V' = sum s eps - E* |s| - s^T (K_v + B) s <= - s^T (K_v + B) s if E* >= |eps|, eq (85)."""
    for name, normalised in itertools.product(("afsmc", "afsmc-consequent"), (False, True)):
        label = f"{name} normalised" if normalised else name
        t = adaptive_trial(name, p, states, rng, normalised=normalised)
        yield from lyapunov.proved(label, t.rate, t.claim, -t.taken)


def misprints(p: ArmParameters, states: int, rng: np.random.Generator) -> Iterator[Check]:
    """The rows of the paper's wrong variants, on an arm whose dampers do not hide them."""
    t = adaptive_trial("afsmc", p.scaled(damping=0.0), states, rng)
    yield lyapunov.noticed("C_j as printed, d/d alpha", printed_C(t).rate, t.claim)
    yield lyapunov.noticed("d/d delta moves sigma", delta_gradient(t).rate, t.claim)
    yield lyapunov.noticed("+ F^ + F_cp in (63)", added_estimate(t).rate, t.claim)
    if p.modules > 1:  # a single module has no Coriolis force
        yield lyapunov.noticed("C laid out as in (4)", paper_coriolis(t).rate, t.claim)


def printed_C(t: _Trial) -> _Trial:
    """C_j as printed in (72): d/d alpha where d/d sigma is meant."""
    eta = etas(t.law)
    return t._replace(rates=t.rates._replace(sigma=eta.sigma / eta.alpha * t.rates.alpha))


def delta_gradient(t: _Trial) -> _Trial:
    """Sigma moved by the gradient in the delta of (59): d/d delta = -sigma^2 d/d sigma."""
    sigma = -np.square(t.now.sigma) * t.rates.sigma
    return t._replace(rates=t.rates._replace(sigma=sigma))


def added_estimate(t: _Trial) -> _Trial:
    """(63) with + F^ + F_cp."""
    s = t.surface.s
    estimate = np.sum(t.now.theta * membership(t.law, s, t.now), axis=-1)  # eq (67)
    return t._replace(force=t.force + 2.0 * (estimate + t.now.E * np.sign(s)))


def paper_coriolis(t: _Trial) -> _Trial:
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


def adaptive_trial(
    name: str, p: ArmParameters, states: int, rng: np.random.Generator, **gains: Any
) -> _Trial:
    """Random instants, values and optimal values, with the tightest E* = |eps|.

    The law is the shipped one, without safeguards and with sgn(s) as the theorem has it.
    """
    at = lyapunov.random_instants(p, states, rng)
    surface = lyapunov.sliding(at)
    F = lyapunov.model_error(at, surface)
    now, best = _random_values(F, rng), _random_values(F, rng)
    gains |= {"lambda": lyapunov.LAMBDA, "K_v": lyapunov.linear_gain_of(p)}
    gains |= {"phi": 0.0, "safeguards": False}
    gains |= {"alpha0": now.alpha, "sigma0": now.sigma}  # where they do not adapt
    law = cast("AdaptiveLaw", make_controller(name, at.nominal, gains))
    # Premises that do not adapt cannot come closer to their best values.
    fixed = isinstance(law, AdaptiveConsequents)
    reached = best._replace(alpha=now.alpha, sigma=now.sigma) if fixed else best
    eps = approximation_error(law, surface.s, F, now, reached)
    best = best._replace(E=np.abs(eps))
    return _Trial(at, law, surface, now, best, eps, *answer(law, at, now))


def answer(
    law: AdaptiveLaw, at: lyapunov.Instants, now: Adapted, step: float = 1.0
) -> tuple[np.ndarray, Adapted]:
    """Force and rates, shapes (..., 2N) and (..., 2N, M), by one exact Euler step [s]."""
    state: Any = law.initial_state(at.measurement.q.shape[:-1])
    before = {name: part for name, part in now._asdict().items() if name in state._fields}
    state = state._replace(t=0.0, **{name: part.copy() for name, part in before.items()})
    command, after = law(state, at.measurement._replace(t=step), at.reference)
    rates = {name: (getattr(after, name) - part) / step for name, part in before.items()}
    return command.force, Adapted(*map(np.zeros_like, now))._replace(**rates)


def etas(law: AdaptiveLaw) -> Adapted:
    """The rates of adaptation eta2, eta3, eta4, eta1, each of the shape of what it adapts."""
    eta3, eta4 = (law.eta3, law.eta4) if isinstance(law, AdaptiveFuzzy) else (0.0, 0.0)
    theta, alpha, sigma = (np.asarray(eta)[..., None] for eta in (law.eta2, eta3, eta4))
    return Adapted(theta, alpha, sigma, np.asarray(law.eta1))


def membership(law: AdaptiveLaw, s: np.ndarray, now: Adapted) -> np.ndarray:
    """phi of eqs (66), (88), or of (58) when normalised, shape (..., 2N, M)."""
    z = (s / law.scale)[..., None]
    exponents = -np.square(now.sigma * (z - now.alpha))
    if not law.normalised:
        return np.exp(exponents)
    # Far from all rules all mu would be 0 in floating point; their shares would not.
    mu = np.exp(exponents - np.max(np.real(exponents), axis=-1, keepdims=True))
    return mu / np.sum(mu, axis=-1, keepdims=True)


def approximation_error(
    law: AdaptiveLaw, s: np.ndarray, error: np.ndarray, now: Adapted, best: Adapted
) -> np.ndarray:
    """eps of eq (73): what of F - f^ is not linear in the parameters' errors, shape (..., 2N)."""
    tilde = difference(best, now)
    step = Adapted(*(x + 1j * lyapunov.COMPLEX_STEP * y for x, y in zip(now, tilde, strict=True)))
    # B alpha~ + C sigma~, eq (71)
    along = np.imag(membership(law, s, step)) / lyapunov.COMPLEX_STEP
    phi_best = membership(law, s, best)
    change = phi_best - membership(law, s, now)
    beyond_estimator = error - np.sum(best.theta * phi_best, axis=-1)
    return np.sum(now.theta * (change - along) + tilde.theta * change, axis=-1) + beyond_estimator


def difference(a: Adapted, b: Adapted) -> Adapted:
    """a - b, part by part."""
    return Adapted(*(x - y for x, y in zip(a, b, strict=True)))


def _random_values(F: np.ndarray, rng: np.random.Generator) -> Adapted:
    """Theta and E of the size of the model error, centres and widths around the usual ones."""
    size = np.sqrt(np.mean(F * F, axis=0))
    rules = (*F.shape, RULES)
    return Adapted(
        theta=size[..., None] * rng.normal(size=rules),
        alpha=rng.uniform(-1.5, 1.5, rules),
        sigma=rng.uniform(0.5, 4.0, rules),
        E=size * rng.uniform(0.0, 1.0, F.shape),
    )

"""The theorem (80)-(87) of the adaptive controllers: trials at random instants and along a run.

Shapes: (...) for the batch, 2N coordinates, M fuzzy rules a coordinate. Energies in J, rates in W.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Any, NamedTuple, cast

import numpy as np

from controllers import AdaptiveConsequents, AdaptiveFuzzy, make_controller
from controllers.proofs.lyapunov import (
    COMPLEX_STEP,
    LAMBDA,
    Instants,
    below,
    damped,
    energy_rate,
    layer_of,
    linear_gain_of,
    model_error,
    proved,
    random_instants,
    rms,
    sliding,
)
from controllers.sliding_mode import Surface
from octarm.arm.lagrange import equilibrium, forward_dynamics, kinetic_energy
from octarm.arm.parameters import ArmParameters
from octarm.interfaces import Measurement, Reference
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


class AdaptiveTrial(NamedTuple):
    """Instants with values of all that an adaptive controller adapts, and what it does there.

    Attributes:
        at: the instants.
        law: the controller, for its scales and rates.
        surface: s and what follows from it.
        now: adapted values.
        best: their optimal values.
        eps: error of the approximation, eq (73), shape (..., 2N) [N], [N m].
        force: what the controller answers, shape (..., 2N) [N], [N m].
        rates: how fast it adapts.
    """

    at: Instants
    law: AdaptiveLaw
    surface: Surface
    now: Adapted
    best: Adapted
    eps: np.ndarray
    force: np.ndarray
    rates: Adapted

    @property
    def taken(self) -> np.ndarray:
        """s^T (K_v + B) s, what the linear gain and the dampers take, shape (...)."""
        return damped(self.at, self.surface.s, self.law.K_v)

    @property
    def claim(self) -> np.ndarray:
        """V' = sum s eps - E* |s| - s^T (K_v + B) s, eq (85), shape (...)."""
        s = self.surface.s
        return np.sum(s * self.eps - self.best.E * np.abs(s), axis=-1) - self.taken

    @property
    def rate(self) -> np.ndarray:
        """V' by the chain rule through the true arm, eq (81) and x~' = -x', eq (84), (...)."""
        learning = _weighted(self.law, difference(self.best, self.now), self.rates)
        return energy_rate(self.at, self.surface, self.force) - learning

    @property
    def parameter_energy(self) -> np.ndarray:
        """The part of V, eq (80), that lies in the parameters' errors, shape (...)."""
        tilde = difference(self.best, self.now)
        return 0.5 * _weighted(self.law, tilde, tilde)

    def unsaturated(self, phi: np.ndarray) -> np.ndarray:
        """What V' gains from sat(s / phi) for sgn(s), at most sum E phi / 4, shape (...)."""
        s = self.surface.s
        return np.sum(self.now.E * (np.abs(s) - s * np.clip(s / phi, -1.0, 1.0)), axis=-1)


def adaptive(p: ArmParameters, states: int, rng: np.random.Generator) -> Iterator[Check]:
    """V' = sum s eps - E* |s| - s^T (K_v + B) s <= - s^T (K_v + B) s if E* >= |eps|, eq (85)."""
    for name, normalised in itertools.product(("afsmc", "afsmc-consequent"), (False, True)):
        label = f"{name} normalised" if normalised else name
        t = adaptive_trial(name, p, states, rng, normalised=normalised)
        yield from proved(label, t.rate, t.claim, -t.taken)
    phi = layer_of(p)
    t = adaptive_trial("afsmc", p, states, rng, phi=phi)
    bound = np.sum(0.25 * t.now.E * phi, axis=-1) - t.taken
    yield from proved("afsmc, E sat(s / phi)", t.rate, t.claim + t.unsaturated(phi), bound)
    yield from _safeguarded(p, states, rng)


def _safeguarded(p: ArmParameters, states: int, rng: np.random.Generator) -> Iterator[Check]:
    """Projection only lowers V' while the best values keep the bounds; the dead zone costs E~ |s|.

    A third of the adapted values is at a bound, the others too far from it for one step.
    """
    at, phi = random_instants(p, states, rng), layer_of(p)
    F = model_error(at, sliding(at))
    law = cast("AdaptiveFuzzy", adaptive_law("afsmc", at, phi=phi, safeguards=True))
    top, reach = law.theta_max[..., None], law.alpha_max[..., None]
    smallest, largest = law.sigma_min[..., None], law.sigma_max[..., None]
    lowest = Adapted(-top, law.alpha0 - reach, smallest, np.zeros_like(law.E_max))
    highest = Adapted(top, law.alpha0 + reach, largest, law.E_max)

    def value(reach: float) -> Adapted:
        drawn = (rng.uniform(-reach, reach, part.shape) for part in _random_values(F, rng))
        places = (np.where(abs(x) > 0.9, np.sign(x), x) for x in drawn)
        spans = zip(lowest, highest, places, strict=True)
        return Adapted(*(low + 0.5 * (high - low) * (1.0 + x) for low, high, x in spans))

    t = _trial(at, law, value(1.35), value(0.9), step=1e-4)
    size = np.abs(t.surface.s)
    resting = np.maximum(t.best.E - t.now.E, 0.0) * (size < law.dead_zone) * size
    bound = t.claim + t.unsaturated(phi) + np.sum(resting, axis=-1)
    yield below("afsmc, safeguards", t.rate, bound, rms(t.claim))


def along_a_run(p: ArmParameters, rng: np.random.Generator) -> Iterator[Check]:
    """V itself along the closed loop in continuous time, against the integral of V'.

    That V falls along a run is no test of a law: with C_j as printed it falls as well. The law is
    the one with sat(s / phi), as integrators make no sense of sgn(s); V' then has a small bound.
    """
    phi, dt, steps = layer_of(p), 5e-4, 500
    with np.errstate(over="ignore", invalid="ignore"):  # NaN passes no row
        trial = _closed_loop(p, rng, phi, steps, dt)
        trial = trial._replace(best=trial.best._replace(E=np.max(np.abs(trial.eps), axis=0)))
        rate, claim = trial.rate, trial.claim + trial.unsaturated(phi)
        energy = kinetic_energy(p, trial.at.measurement.q, trial.surface.s)
        V = (energy + trial.parameter_energy) / rms(claim)
        pairs = rate[:-2:2] + 4.0 * rate[1:-1:2] + rate[2::2]  # Simpson's rule over two steps
        integral = np.cumsum(pairs, axis=0) * (dt / 3.0) / rms(claim)
        bound = 0.25 * np.sum(trial.now.E * phi, axis=-1)
        yield from proved("afsmc along a run", rate, claim, bound)
        off = np.max(np.abs(V[2::2] - V[0] - integral)) / (steps * dt)
        yield Check("afsmc along a run: V - its integrated V', a second", float(off), 1e-3)
        left = float(np.max(V[-1] / V[0]))
        yield Check("afsmc along a run: V at its end, of that at its start", left, 1.0, 0.0)


def _closed_loop(
    p: ArmParameters, rng: np.random.Generator, phi: np.ndarray, steps: int, dt: float
) -> AdaptiveTrial:
    """Four arms that follow a sine with models up to 30 % off, by RK4 on law and arm together.

    The trial has the shape (steps + 1, 4). The best parameters are those at the end, as they would
    be had the law converged. The state x of the integration holds q, v, E, and the rules.
    """
    off = 1.0 + 0.3 * np.array([-1.0, -0.5, 0.5, 1.0])[:, None]
    nominal = p.scaled(mass=off, inertia=off, stiffness=0.5 + 0.5 * off[..., None])
    rest, size = equilibrium(p), np.repeat([0.01, 0.2], p.modules)

    def at(t: Any, x: np.ndarray) -> Instants:
        q, v, angle = x[..., 0], x[..., 1], np.pi * np.asarray(t)[..., None, None]
        wave = np.sin(angle), np.pi * np.cos(angle), -(np.pi**2) * np.sin(angle)
        q_d, v_d, a_d = (np.broadcast_to(size * part, q.shape) for part in wave)
        reference = Reference(rest + q_d, v_d, a_d)
        return Instants(p, nominal, Measurement(1.0, q, v), reference, np.zeros_like(q))

    def adapted(x: np.ndarray) -> Adapted:
        return Adapted(*np.split(x[..., 3:], 3, axis=-1), E=x[..., 2])

    def state(q: np.ndarray, v: np.ndarray, now: Any) -> np.ndarray:
        alone = np.stack([q, v, now.E], axis=-1)
        return np.concatenate([alone, now.theta, now.alpha, now.sigma], axis=-1)

    def rates(t: float, x: np.ndarray) -> np.ndarray:
        force, adaptation = answer(law, at(t, x), adapted(x))
        return state(x[..., 1], forward_dynamics(p, x[..., 0], x[..., 1], force), adaptation)

    def advanced(t: float, x: np.ndarray) -> np.ndarray:
        k1 = rates(t, x)
        k2 = rates(t + 0.5 * dt, x + 0.5 * dt * k1)
        k3 = rates(t + 0.5 * dt, x + 0.5 * dt * k2)
        k4 = rates(t + dt, x + dt * k3)
        return x + dt * ((k1 + 2.0 * (k2 + k3) + k4) / 6.0)

    q = rest + size * rng.uniform(-1.0, 1.0, (4, rest.size))
    law = adaptive_law("afsmc", at(0.0, np.stack([q, q], axis=-1)), phi=phi)
    times, path = dt * np.arange(steps + 1), [state(q, np.zeros_like(q), law.initial_state((4,)))]
    for t in times[:-1]:
        path.append(advanced(t, path[-1]))
    x = np.stack(path)
    return _trial(at(times, x), law, adapted(x), adapted(x[-1]))


def adaptive_trial(
    name: str, p: ArmParameters, states: int, rng: np.random.Generator, **gains: Any
) -> AdaptiveTrial:
    """Random instants, values and optimal values, with the tightest E* = |eps|."""
    at = random_instants(p, states, rng)
    F = model_error(at, sliding(at))
    now, best = _random_values(F, rng), _random_values(F, rng)
    premises = {"alpha0": now.alpha, "sigma0": now.sigma}  # where they do not adapt
    t = _trial(at, adaptive_law(name, at, **premises, **gains), now, best)
    return t._replace(best=t.best._replace(E=np.abs(t.eps)))


def adaptive_law(name: str, at: Instants, **gains: Any) -> AdaptiveLaw:
    """The shipped controller, without safeguards and with sgn(s) as the theorem has it."""
    literal = {"lambda": LAMBDA, "K_v": linear_gain_of(at.true), "phi": 0.0, "safeguards": False}
    return cast("AdaptiveLaw", make_controller(name, at.nominal, literal | gains))


def _trial(
    at: Instants, law: AdaptiveLaw, now: Adapted, best: Adapted, step: float = 1.0
) -> AdaptiveTrial:
    surface = sliding(at)
    # Premises that do not adapt cannot come closer to their best values.
    adapts = np.any(etas(law).alpha) or np.any(etas(law).sigma)
    reached = best if adapts else best._replace(alpha=now.alpha, sigma=now.sigma)
    eps = approximation_error(law, surface.s, model_error(at, surface), now, reached)
    return AdaptiveTrial(at, law, surface, now, best, eps, *answer(law, at, now, step))


def answer(
    law: AdaptiveLaw, at: Instants, now: Adapted, step: float = 1.0
) -> tuple[np.ndarray, Adapted]:
    """Force and rates, the rates from one Euler step [s], which is exact while no bound acts."""
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


def membership_along(law: AdaptiveLaw, s: np.ndarray, now: Adapted, step: Adapted) -> np.ndarray:
    """B alpha + C sigma of eq (71): phi's derivative along step's alpha and sigma, (..., 2N, M)."""
    moved = now._replace(
        alpha=now.alpha + 1j * COMPLEX_STEP * step.alpha,
        sigma=now.sigma + 1j * COMPLEX_STEP * step.sigma,
    )
    return np.imag(membership(law, s, moved)) / COMPLEX_STEP


def approximation_error(
    law: AdaptiveLaw, s: np.ndarray, error: np.ndarray, now: Adapted, best: Adapted
) -> np.ndarray:
    """eps of eq (73): what of F - f^ is not linear in the parameters' errors, shape (..., 2N)."""
    tilde = difference(best, now)
    phi, phi_best = membership(law, s, now), membership(law, s, best)
    change = phi_best - phi
    higher_order = change - membership_along(law, s, now, tilde)
    beyond_estimator = error - np.sum(best.theta * phi_best, axis=-1)
    return np.sum(now.theta * higher_order + tilde.theta * change, axis=-1) + beyond_estimator


def difference(a: Adapted, b: Adapted) -> Adapted:
    """a - b, part by part."""
    return Adapted(*(x - y for x, y in zip(a, b, strict=True)))


def _weighted(law: AdaptiveLaw, a: Adapted, b: Adapted) -> np.ndarray:
    """sum of a b / eta; where eta is 0, nothing adapts and any weight does: 1."""
    weights = (np.where(eta == 0.0, 1.0, eta) for eta in etas(law))
    terms = Adapted(*(x * y / weight for x, y, weight in zip(a, b, weights, strict=True)))
    return np.sum(terms.E + np.sum(terms.theta + terms.alpha + terms.sigma, axis=-1), axis=-1)


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

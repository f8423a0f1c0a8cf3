"""The adaptive controllers' part of the Lyapunov ledger: the theorem (80)-(87)."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, cast

import numpy as np

from controllers import AdaptiveFuzzy, make_controller
from controllers.proofs.lyapunov import (
    LAMBDA,
    Adapted,
    AdaptiveLaw,
    Instants,
    approximation_error,
    below,
    damped,
    energy_rate,
    layer_of,
    linear_gain_of,
    model_error,
    parameter_energy,
    parameter_rate,
    proved,
    random_instants,
    random_nominal,
    rates_of,
    rms,
    sliding,
)
from controllers.sliding_mode import Surface
from octarm.arm.lagrange import equilibrium, forward_dynamics, kinetic_energy
from octarm.arm.parameters import ArmParameters
from octarm.checks.report import Check
from octarm.interfaces import Measurement, Reference


class Answer(NamedTuple):
    """What an adaptive controller does at n instants.

    Attributes:
        force: Q, shape (n, 2N) [N], [N m].
        rates: of all that it adapts, per s.
    """

    force: np.ndarray
    rates: Adapted


class AdaptiveTrial(NamedTuple):
    """Instants with values of all that an adaptive controller adapts, and what it does there.

    Attributes:
        at: the instants.
        law: the controller, for its scales and rates.
        surface: s and what follows from it.
        now: adapted values.
        best: their optimal values.
        eps: error of the approximation, eq (73), shape (n, 2N) [N], [N m].
        answer: what the controller does.
    """

    at: Instants
    law: AdaptiveLaw
    surface: Surface
    now: Adapted
    best: Adapted
    eps: np.ndarray
    answer: Answer

    @property
    def taken(self) -> np.ndarray:
        """s^T (K_v + B) s, what the linear gain and the dampers take, shape (n,) [W]."""
        return damped(self.at, self.surface.s, self.law.K_v)

    @property
    def claim(self) -> np.ndarray:
        """V' = sum s eps - E* |s| - s^T (K_v + B) s, eq (85), shape (n,) [W]."""
        s = self.surface.s
        return np.sum(s * self.eps - self.best.E * np.abs(s), axis=-1) - self.taken

    def rate(self, answer: Answer | None = None) -> np.ndarray:
        """V' by the chain rule through the true arm, eq (81), shape (n,) [W]."""
        force, rates = answer or self.answer
        learning = parameter_rate(self.law, self.now, self.best, rates)
        return energy_rate(self.at, self.surface, force) + learning


def adaptive(p: ArmParameters, states: int, rng: np.random.Generator) -> Iterator[Check]:
    """V' = sum s eps - E* |s| - s^T (K_v + B) s <= - s^T (K_v + B) s if E* >= |eps|, eq (85)."""
    for name, normalised in itertools.product(("afsmc", "afsmc-consequent"), (False, True)):
        label = f"{name} normalised" if normalised else name
        t = adaptive_trial(name, p, states, rng, normalised=normalised)
        yield from proved(label, t.rate(), t.claim, -t.taken)
    yield from _saturated(p, states, rng)
    yield from _safeguarded(p, states, rng)


def _saturated(p: ArmParameters, states: int, rng: np.random.Generator) -> Iterator[Check]:
    """E sat(s / phi) in place of E sgn(s): V' may exceed that by sum E phi / 4."""
    phi = layer_of(p)
    t = adaptive_trial("afsmc", p, states, rng, phi=phi)
    claim = t.claim + np.sum(t.now.E * _unsaturated(t.surface.s, phi), axis=-1)
    bound = np.sum(0.25 * t.now.E * phi, axis=-1) - t.taken
    yield from proved("afsmc, E sat(s / phi)", t.rate(), claim, bound)


def _safeguarded(p: ArmParameters, states: int, rng: np.random.Generator) -> Iterator[Check]:
    """Projection only lowers V' while the best values keep the bounds; the dead zone costs E~ |s|.

    A third of the adapted values is at a bound, the others too far from it for one step.
    """
    at = random_instants(p, random_nominal(p, states, rng), LAMBDA, rng)
    s, F = sliding(at, LAMBDA).s, model_error(at, sliding(at, LAMBDA))
    law = cast("AdaptiveFuzzy", adaptive_law("afsmc", p, at.nominal, phi=layer_of(p)))
    top, reach = each_rule(law.theta_max), each_rule(law.alpha_max)
    lowest = Adapted(-top, law.alpha0 - reach, each_rule(law.sigma_min), np.zeros_like(law.E_max))
    highest = Adapted(top, law.alpha0 + reach, each_rule(law.sigma_max), law.E_max)

    def value(reach: float) -> Adapted:
        drawn = (rng.uniform(-reach, reach, part.shape) for part in _random_values(F, rng))
        places = (np.where(abs(x) > 0.9, np.sign(x), x) for x in drawn)
        spans = zip(lowest, highest, places, strict=True)
        return Adapted(*(low + 0.5 * (high - low) * (1.0 + x) for low, high, x in spans))

    t = _compared(at, law, value(1.35), value(0.9), step=1e-4)
    resting = np.maximum(t.best.E - t.now.E, 0.0) * (np.abs(s) < law.dead_zone)
    bound = t.claim + np.sum(t.now.E * _unsaturated(s, law.phi) + resting * np.abs(s), axis=-1)
    yield below("afsmc, safeguards", t.rate(), bound, rms(t.claim))


def along_a_run(p: ArmParameters, rng: np.random.Generator) -> Iterator[Check]:
    """V itself along the closed loop in continuous time, against the integral of V'.

    That V falls along a run is no test of a law: with C_j as printed it falls as well. The law is
    the one with sat(s / phi), as integrators make no sense of sgn(s); V' then has a small bound.
    """
    phi = layer_of(p)
    with np.errstate(over="ignore", invalid="ignore"):  # NaN passes no row
        t, trial = _closed_loop(p, rng, phi)
        trial = trial._replace(best=trial.best._replace(E=np.max(np.abs(trial.eps), axis=0)))
        s, E = trial.surface.s, trial.now.E
        rate, claim = trial.rate(), trial.claim + np.sum(E * _unsaturated(s, phi), axis=-1)
        energy = kinetic_energy(p, trial.at.measurement.q, s)
        V = (energy + parameter_energy(trial.law, trial.now, trial.best)) / rms(claim)
        pairs = rate[:-2:2] + 4.0 * rate[1:-1:2] + rate[2::2]  # Simpson's rule over two steps
        integral = np.cumsum(pairs, axis=0) * (t[1] / 3.0) / rms(claim)
        bound = 0.25 * np.sum(E * phi, axis=-1)
        yield from proved("afsmc along a run", rate, claim, bound)
        difference = np.max(np.abs(V[2::2] - V[0] - integral)) / t[-1]
        yield Check("afsmc along a run: V - its integrated V', a second", float(difference), 1e-3)
        left = float(np.max(V[-1] / V[0]))
        yield Check("afsmc along a run: V at its end, of that at its start", left, 1.0, 0.0)


def _closed_loop(
    p: ArmParameters,
    rng: np.random.Generator,
    phi: np.ndarray,
    steps: int = 500,
    dt: float = 5e-4,
) -> tuple[np.ndarray, AdaptiveTrial]:
    """Four arms that follow a sine with models up to 30 % off, by RK4 on law and arm together.

    Returns:
        The times, shape (steps + 1,), and all instants as a trial of shape (steps + 1, 4). The best
        parameters are those at the end, as they would be had the law converged.
    """
    off = 1.0 + 0.3 * np.array([-1.0, -0.5, 0.5, 1.0])[:, None]
    nominal = p.scaled(mass=off, inertia=off, stiffness=0.5 + 0.5 * off[..., None])
    law = literal("afsmc", p, nominal, phi=phi)
    rest, size = equilibrium(p), np.repeat([0.01, 0.2], p.modules)

    def at(t: np.ndarray, x: Any) -> Instants:
        angle = np.pi * t[..., None, None]
        wave = np.sin(angle), np.pi * np.cos(angle), -(np.pi**2) * np.sin(angle)
        q_d, v_d, a_d = (np.broadcast_to(size * part, x[0].shape) for part in wave)
        reference = Reference(rest + q_d, v_d, a_d)
        return Instants(p, nominal, Measurement(1.0, x[0], x[1]), reference, np.zeros_like(x[0]))

    def rates(t: np.ndarray, x: Any) -> Any:
        force, adaptation = answer(law, at(t, x), Adapted(*x[2:]))
        return (x[1], forward_dynamics(p, x[0], x[1], force), *adaptation)

    first: Any = law.initial_state((4,))
    q = rest + size * rng.uniform(-1.0, 1.0, (4, rest.size))
    t = dt * np.arange(steps + 1)
    path = [(q, np.zeros_like(q), first.theta, first.alpha, first.sigma, first.E)]
    for now in t[:-1]:
        path.append(_rk4_step(rates, now, path[-1], dt))
    q, v, *adapted = map(np.stack, zip(*path, strict=True))
    now = Adapted(*adapted)
    best = Adapted(*(part[-1] for part in now))
    return t, _compared(at(t, (q, v)), law, now, best)


def _rk4_step(rates: Callable[[Any, Any], Any], t: Any, x: Any, h: float) -> Any:
    def moved(by: Any, step: float) -> Any:
        return tuple(a + step * b for a, b in zip(x, by, strict=True))

    k1 = rates(t, x)
    k2 = rates(t + 0.5 * h, moved(k1, 0.5 * h))
    k3 = rates(t + 0.5 * h, moved(k2, 0.5 * h))
    k4 = rates(t + h, moved(k3, h))
    slopes = zip(k1, k2, k3, k4, strict=True)
    return moved([(a + 2.0 * (b + c) + d) / 6.0 for a, b, c, d in slopes], h)


def adaptive_trial(
    name: str, p: ArmParameters, states: int, rng: np.random.Generator, **gains: Any
) -> AdaptiveTrial:
    """Random instants, values and optimal values, with the tightest E* = |eps|."""
    at = random_instants(p, random_nominal(p, states, rng), LAMBDA, rng)
    F = model_error(at, sliding(at, LAMBDA))
    now, best = _random_values(F, rng), _random_values(F, rng)
    premises = {"alpha0": now.alpha, "sigma0": now.sigma}  # where they do not adapt
    t = _compared(at, literal(name, p, at.nominal, **premises, **gains), now, best)
    return t._replace(best=t.best._replace(E=np.abs(t.eps)))


def literal(name: str, p: ArmParameters, nominal: ArmParameters, **gains: Any) -> AdaptiveLaw:
    """The controller without safeguards and with sgn(s), as the theorem has it."""
    return adaptive_law(name, p, nominal, **({"phi": 0.0, "safeguards": False} | gains))


def adaptive_law(name: str, p: ArmParameters, nominal: ArmParameters, **gains: Any) -> AdaptiveLaw:
    """The adaptive controller of this name, as it is shipped but for these gains."""
    given = {"lambda": LAMBDA, "K_v": linear_gain_of(p)} | gains
    return cast("AdaptiveLaw", make_controller(name, nominal, given))


def _compared(
    at: Instants, law: AdaptiveLaw, now: Adapted, best: Adapted, step: float = 1.0
) -> AdaptiveTrial:
    surface = sliding(at, LAMBDA)
    # Premises that do not adapt cannot come closer to their best values.
    adapts = np.any(rates_of(law)[2]) or np.any(rates_of(law)[3])
    reached = best if adapts else best._replace(alpha=now.alpha, sigma=now.sigma)
    eps = approximation_error(law, surface.s, model_error(at, surface), now, reached)
    return AdaptiveTrial(at, law, surface, now, best, eps, answer(law, at, now, step))


def answer(law: AdaptiveLaw, at: Instants, now: Adapted, step: float = 1.0) -> Answer:
    """Force and rates, the rates from one Euler step [s], which is exact while no bound acts."""
    state: Any = law.initial_state(at.measurement.q.shape[:-1])
    before = {name: part for name, part in now._asdict().items() if name in state._fields}
    state = state._replace(t=0.0, **{name: part.copy() for name, part in before.items()})
    command, after = law(state, at.measurement._replace(t=step), at.reference)
    rates = {name: (getattr(after, name) - part) / step for name, part in before.items()}
    return Answer(command.force, Adapted(*map(np.zeros_like, now))._replace(**rates))


def _unsaturated(s: np.ndarray, phi: Any) -> np.ndarray:
    """|s| - s sat(s / phi), at most phi / 4, shape (..., 2N)."""
    return np.abs(s) - s * np.clip(s / phi, -1.0, 1.0)


def _random_values(F: np.ndarray, rng: np.random.Generator) -> Adapted:
    """Theta and E of the size of the model error, centres and widths around the usual ones."""
    size = np.sqrt(np.mean(F * F, axis=0))
    rules = (*F.shape, 5)
    return Adapted(
        theta=each_rule(size) * rng.normal(size=rules),
        alpha=rng.uniform(-1.5, 1.5, rules),
        sigma=rng.uniform(0.5, 4.0, rules),
        E=size * rng.uniform(0.0, 1.0, F.shape),
    )


def each_rule(x: Any) -> np.ndarray:
    """One value a coordinate, for each of its rules: shape (..., 2N) to (..., 2N, 1)."""
    return np.asarray(x)[..., None]

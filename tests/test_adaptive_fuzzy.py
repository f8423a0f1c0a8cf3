"""The fuzzy estimators and the adaptive controllers against their equations and their promises."""
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false
# (gains are fields of the classes behind the Controller protocol)

from typing import Any, NamedTuple

import mujoco
import numpy as np
import pytest
from arm_states import REST, UNLIMITED, P, hand_set, random_instant
from scipy import stats

from controllers.adaptive_fuzzy import premise_rate
from controllers.fuzzy.estimators import first_type, second_type, strengths
from controllers.recommended import boundary_width
from octarm.arm.lagrange import (
    coriolis_matrix,
    damping_matrix,
    inverse_dynamics,
    mass_matrix,
    potential_force,
)
from octarm.arm.mjcf import build_model, paper_order
from octarm.arm.nominal import LagrangeModel
from octarm.interfaces import Controller, Measurement, Reference
from octarm.references import named_reference
from octarm.simulation.environment import load
from octarm.simulation.rollout import rollout
from octarm.simulation.trajectory import Trajectory
from octarm.sweeps.tune import gains_of

WRONG = UNLIMITED.mismatched(-0.3)
ADAPTIVE = ("afsmc", "afsmc-consequent")
both_kinds = pytest.mark.parametrize("normalised", [False, True])
M = 5
MODEL = LagrangeModel(WRONG)
LAYER = boundary_width(MODEL)


# ------------------------------------------------------------------------------- estimators


def random_estimator(inputs: int, n: int = 20) -> tuple[np.ndarray, ...]:
    """theta, alpha, sigma and x for n estimators of M rules."""
    draw = np.random.default_rng(inputs)
    alpha = draw.uniform(-1.5, 1.5, (n, inputs, M))
    sigma = draw.uniform(0.3, 2.5, (n, inputs, M))
    return draw.normal(size=(n, M)), alpha, sigma, draw.uniform(-1.5, 1.5, (n, inputs))


@both_kinds
@pytest.mark.parametrize("inputs", [1, 2, 3])
def test_the_gradient_is_the_derivative_of_the_value(inputs: int, normalised: bool):
    """By a complex step in each parameter, which has no rounding error."""
    parameters = dict(zip(("theta", "alpha", "sigma", "x"), random_estimator(inputs), strict=True))
    estimate = second_type(**parameters, normalised=normalised)
    for name in ("theta", "alpha", "sigma"):
        gradient = getattr(estimate, f"d_{name}")
        assert gradient.shape == parameters[name].shape
        for index in np.ndindex(gradient.shape[1:]):
            moved = {key: value.astype(complex) for key, value in parameters.items()}
            moved[name][(slice(None), *index)] += 1e-30j
            slope = second_type(**moved, normalised=normalised).value.imag / 1e-30
            np.testing.assert_allclose(
                gradient[(slice(None), *index)], slope, rtol=1e-9, atol=1e-12
            )


@both_kinds
def test_premises_act_through_the_jacobians_of_all_strengths(normalised: bool):
    """B^T theta and C^T theta, eq (72) corrected; B and C are diagonal unless normalised."""
    theta, alpha, sigma, x = random_estimator(1)
    estimate = second_type(theta, alpha, sigma, x, normalised=normalised)
    for k, gradient in enumerate((estimate.d_alpha, estimate.d_sigma)):
        columns = []
        for rule in range(M):
            moved = [alpha.astype(complex), sigma.astype(complex)]
            moved[k][:, 0, rule] += 1e-30j
            columns.append(strengths(x, *moved, normalised=normalised).imag / 1e-30)
        jacobian = np.stack(columns, axis=-1)
        np.testing.assert_allclose(
            np.einsum("nrl,nr->nl", jacobian, theta), gradient[:, 0], rtol=1e-9, atol=1e-12
        )
        off_diagonal = np.max(np.abs(jacobian * (1.0 - np.eye(M))))
        assert off_diagonal > 0.01 if normalised else off_diagonal == 0.0


def test_the_first_type_is_the_printed_quotient():
    """Eqs (58) and (59): sum theta prod mu / sum prod mu, with delta = 1 / sigma."""
    theta, alpha, sigma, x = random_estimator(2)
    mu = np.prod(np.exp(-np.square((x[..., None] - alpha) * sigma)), axis=-2)
    xi = strengths(x, alpha, sigma, normalised=True)
    value = first_type(theta, xi)
    np.testing.assert_allclose(value, np.sum(theta * mu, -1) / np.sum(mu, -1), rtol=1e-12)
    np.testing.assert_allclose(strengths(x, alpha, sigma, normalised=False), mu, rtol=1e-12)
    np.testing.assert_allclose(np.sum(xi, axis=-1), 1.0)
    assert np.all((np.min(theta, -1) <= value) & (value <= np.max(theta, -1)))
    same = second_type(theta, alpha, sigma, x, normalised=True)
    np.testing.assert_array_equal(same.value, value)


def test_far_from_all_rules_the_nearest_one_decides():
    """The memberships are 0 in floating point there; normalised ones still add up to 1."""
    alpha, sigma = np.linspace(-1.0, 1.0, M)[None, :], np.full((1, M), 2.0)
    theta, x = np.arange(1.0, M + 1.0), np.array([[-1e4], [60.0]])
    assert np.all(strengths(x, alpha, sigma, normalised=False) == 0.0)
    estimate = second_type(theta, alpha, sigma, x, normalised=True)
    np.testing.assert_allclose(estimate.value, [1.0, 5.0])
    assert all(np.all(np.isfinite(part)) for part in estimate)


# -------------------------------------------------------------------------------- the law


def layer_instant(n: int, seed: int = 0) -> tuple[Measurement, Reference]:
    """Random instants with s within two boundary layers, where the rules are."""
    measurement, (q_d, _, a_d) = random_instant(n, seed=seed)
    s = np.random.default_rng(seed + 1).uniform(-2.0, 2.0, (n, 6)) * boundary_width(
        LagrangeModel(P)
    )
    return measurement, Reference(q_d, measurement.v + 15.0 * (measurement.q - q_d) - s, a_d)


def random_state(controller: Any, n: int, seed: int = 3) -> Any:
    """A state in the middle of an episode, of plain memory order, in part outside the bounds."""
    draw = np.random.default_rng(seed)
    fresh = controller.initial_state((n,))
    values = {"theta": 2.0 * draw.normal(size=(n, 6, M)), "E": draw.uniform(0.0, 1.0, (n, 6))}
    if "alpha" in fresh._fields:
        values["alpha"] = draw.uniform(-2.0, 2.0, (n, 6, M))
        values["sigma"] = draw.uniform(0.2, 4.0, (n, 6, M))
    return fresh._replace(t=0.299, **values)


@both_kinds
@pytest.mark.parametrize("phi", [0.0, 0.3])
def test_force_and_adaptation_are_the_printed_laws(normalised: bool, phi: float):
    """Eqs (63), (75)-(79) with matrices and loops, at random states."""
    gains = {"safeguards": False, "normalised": normalised, "phi": phi}
    c = hand_set("afsmc", WRONG, gains)
    (t, q, v), (q_d, v_d, a_d) = instant = layer_instant(30)
    before = random_state(c, 30)
    command, after = c(before, *instant)
    e, e_dot = q - q_d, v - v_d
    s, v_r, a_r = e_dot + c.lambda_ * e, v_d - c.lambda_ * e, a_d - c.lambda_ * e_dot
    rates = coriolis_matrix(WRONG, q, v) + damping_matrix(WRONG)
    model = np.einsum("nij,nj->ni", mass_matrix(WRONG, q), a_r) + potential_force(WRONG, q)
    model += np.einsum("nij,nj->ni", rates, v_r)
    z = (s / c.scale)[..., None]
    mu = np.exp(-np.square(before.sigma * (z - before.alpha)))
    B = np.eye(M) * (2.0 * before.sigma**2 * (z - before.alpha) * mu)[..., None, :]
    C = np.eye(M) * (-2.0 * before.sigma * (z - before.alpha) ** 2 * mu)[..., None, :]
    if normalised:  # quotient rule: phi^r = mu^r / S, d phi^r = d mu^r / S - mu^r dS / S^2
        S = np.sum(mu, axis=-1)[..., None, None]
        B, C = (J / S - mu[..., None] * np.sum(J, axis=-2, keepdims=True) / S**2 for J in (B, C))
        mu = mu / S[..., 0]
    f_hat = np.sum(before.theta * mu, axis=-1)
    sat = np.clip(s / phi, -1.0, 1.0) if phi else np.sign(s)
    force = model - f_hat - before.E * sat - c.K_v * s
    np.testing.assert_allclose(command.force, force, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(command.signals["f_hat"], f_hat, rtol=1e-9, atol=1e-12)
    expected = {
        "theta": (c.eta2 * s)[..., None] * mu,
        "alpha": (c.eta3 * s)[..., None] * np.einsum("njrl,njr->njl", B, before.theta),
        "sigma": (c.eta4 * s)[..., None] * np.einsum("njrl,njr->njl", C, before.theta),
        "E": c.eta1 * np.abs(s),
    }
    for name, rate in expected.items():
        change = (getattr(after, name) - getattr(before, name)) / (t - before.t)
        np.testing.assert_allclose(change, rate, rtol=1e-9, atol=1e-9 * np.max(np.abs(rate)))
        np.testing.assert_array_equal(command.signals[name], getattr(before, name))


@both_kinds
def test_consequents_alone_are_the_full_law_without_eta3_and_eta4(normalised: bool):
    gains = {"normalised": normalised}
    lean = hand_set("afsmc-consequent", WRONG, gains)
    full = hand_set("afsmc", WRONG, {**gains, "eta3": 0.0, "eta4": 0.0})
    states = lean.initial_state((8,)), full.initial_state((8,))
    for k in range(20):
        measurement, reference = layer_instant(8, seed=k)
        measurement = measurement._replace(t=5e-4 * k)
        one, less = lean(states[0], measurement, reference)
        two, more = full(states[1], measurement, reference)
        np.testing.assert_array_equal(one.force, two.force)
        np.testing.assert_array_equal(less.theta, more.theta)
        np.testing.assert_array_equal(less.E, more.E)
        states = less, more


@pytest.mark.parametrize("name", ADAPTIVE)
def test_nothing_adapts_before_time_has_passed(name: str):
    controller = hand_set(name, WRONG)
    instant = random_instant(4)
    initial = controller.initial_state((4,))
    first = controller(initial, *instant)[1]
    again = controller(first, *instant)[1]
    for part, now, later in zip(initial[1:], first[1:], again[1:], strict=True):
        np.testing.assert_array_equal(part, now)
        np.testing.assert_array_equal(part, later)
    with pytest.raises(ValueError, match="time must not go back"):
        controller(first, instant[0]._replace(t=0.0), instant[1])


def within_bounds(controller: Any, parts: Any) -> bool:
    """Whether theta, E and, where they adapt, alpha and sigma obey their bounds."""
    c, each = controller, lambda bound: bound[..., None]
    good = [np.abs(parts["theta"]) <= each(c.theta_max), parts["E"] <= c.E_max, parts["E"] >= 0.0]
    if "alpha" in parts:
        good += [np.abs(parts["alpha"] - c.alpha0) <= each(c.alpha_max) + 1e-15]
        good += [parts["sigma"] >= each(c.sigma_min), parts["sigma"] <= each(c.sigma_max)]
    return all(map(np.all, good))


@pytest.mark.parametrize("name", ADAPTIVE)
def test_safeguards_project_and_each_can_be_switched_off(name: str):
    literal = hand_set(name, WRONG, {"safeguards": 0})
    kept = hand_set(name, WRONG)
    instant, before = layer_instant(50), random_state(kept, 50)
    printed, bounded = literal(before, *instant)[1], kept(before, *instant)[1]
    assert within_bounds(kept, bounded._asdict()) and not within_bounds(kept, printed._asdict())
    off = {"theta_max": np.inf, "E_max": np.inf, "dead_zone": 0.0}
    switches = {"theta": ("theta_max",), "E": ("E_max", "dead_zone")}
    if name == "afsmc":
        off |= {"alpha_max": np.inf, "sigma_min": 0.0, "sigma_max": np.inf}
        switches |= {"alpha": ("alpha_max",), "sigma": ("sigma_min", "sigma_max")}
    for part, gains in switches.items():
        one_off = hand_set(name, WRONG, {gain: off[gain] for gain in gains})
        after = one_off(before, *instant)[1]
        for other in switches:
            expected = printed if other == part else bounded
            np.testing.assert_array_equal(getattr(after, other), getattr(expected, other))


def test_E_rests_in_the_dead_zone():
    controller = hand_set("afsmc", WRONG, {"dead_zone": LAYER, "E_max": np.inf})
    instant, before = layer_instant(50), random_state(controller, 50)
    command, after = controller(before, *instant)
    resting = np.abs(command.signals["s"]) < LAYER
    assert 0.1 < resting.mean() < 0.9
    np.testing.assert_array_equal(after.E == before.E, resting)


@pytest.mark.parametrize(
    ("gain", "message"),
    [
        ({"eta2": -1.0}, "eta2 holds -1; it must be at least 0"),
        ({"eta1": np.inf}, "eta1 holds inf; it must be finite"),
        ({"scale": 0.0}, "scale holds 0; it must be above 0"),
        ({"theta_max": np.nan}, "theta_max holds nan; it must be finite"),
        ({"E_max": [1.0, 2.0]}, "E_max has 2 values; it needs 1 or 6"),
        ({"E_max": "big"}, "E_max is 'big'; it must be made of numbers"),
        ({"sigma0": 0.0}, "sigma0 holds 0; it must be above 0"),
        ({"alpha0": np.zeros((3, 5))}, r"alpha0 has shape \(3, 5\); it must be \(M,\) or"),
        ({"sigma0": [1.0, 2.0]}, "sigma0 is for 2 rules and alpha0 for 5; they must fit"),
        ({"safeguards": 2.0}, "safeguards is 2.0; it must be True or False, or 1 or 0"),
        ({"sigma_min": 4.0}, "sigma_min holds 4; it must not exceed sigma_max, which holds 3"),
    ],
)
def test_bad_gains_are_refused_in_one_sentence(gain: dict, message: str):
    with pytest.raises(ValueError, match=message):
        hand_set("afsmc", P, gain)


# ----------------------------------------------------------------------------- in closed loop


def run(name: str, duration: float, timestep: float = 5e-4, **gains: Any) -> Trajectory:
    """The default sine with the nominal model at -30 %."""
    environment = load(timestep=timestep)
    return rollout(environment, hand_set(name, WRONG, gains), duration)


def rms(error: np.ndarray) -> np.ndarray:
    return np.sqrt(np.mean(np.square(error), axis=0))


def activity(trajectory: Trajectory) -> np.ndarray:
    """Mean |dQ| a control period, shape (6,)."""
    return np.mean(np.abs(np.diff(trajectory.force, axis=0)), axis=0)


def test_a_wrong_model_is_learnt_without_chattering():
    """At -30 %: at least 4 times the accuracy of a boundary layer, at a 50th of the switching."""
    sign, layer = run("smc", 2.0), run("smc-boundary", 2.0)
    settled = layer.t > 1.0
    for name in ADAPTIVE:
        learning = run(name, 2.0)
        better = rms(layer.error[settled]) / rms(learning.error[settled])
        assert np.all(better[3:5] > 4.0) and np.all(better[:3] > 4.0)
        assert np.all(activity(sign) > 50.0 * activity(learning))


def test_the_printed_law_drifts_under_sampling_and_the_safeguarded_one_does_not():
    """E' = eta1 |s| >= 0 with sgn(s): sampled at 1 kHz, s never rests, E grows ever faster."""
    printed = run("afsmc", 4.0, timestep=1e-3, phi=0.0, safeguards=False)
    kept = run("afsmc", 4.0, timestep=1e-3, phi=0.0)
    theta1, seconds = 3, np.array([1000, 2000, 3000, 3999])
    E = printed.signals["E"][seconds, theta1]
    growth = np.diff(E)
    assert np.all(growth[1:] > 1.5 * growth[:-1]) and E[-1] > 30.0 * E[0]
    assert activity(printed)[theta1] > 10.0 * activity(kept)[theta1]
    E_kept = kept.signals["E"]
    assert np.all(E_kept <= hand_set("afsmc", WRONG).E_max)
    np.testing.assert_array_equal(E_kept[2000:], E_kept[[2000]] + 0.0 * E_kept[2000:])


class Seconds(NamedTuple):
    """What happened in each second of a run of T seconds.

    Attributes:
        error: root mean square of e, shape (T, 6) [m], [rad].
        activity: mean |dQ| a control period, shape (T, 6) [N], [N m].
        learnt: the state at the end of each.
    """

    error: np.ndarray
    activity: np.ndarray
    learnt: list[Any]


NOISE_HOLD = 20  # control periods, 10 ms


def noise_size() -> np.ndarray:
    """40 % of the amplitude of each joint's Q on the default sine, as if that was a sine."""
    motion = named_reference("sine", REST)
    Q = [inverse_dynamics(P, *motion(t)) for t in np.arange(0.0, 2.0, 1e-3)]
    return 0.4 * np.sqrt(2.0) * np.std(Q, axis=0)


def disturbed(controller: Controller, seconds: int, seed: int = 0) -> Seconds:
    """The default sine at 2 kHz with noise on Q that holds for 10 ms, in a lean loop."""
    rate, model = 2000, build_model(timestep=1.0 / 2000)
    data, (qpos_index, qvel_index) = mujoco.MjData(model), paper_order(model)
    data.qpos[:] = model.key("hanging").qpos
    motion, size, draw = named_reference("sine", REST), noise_size(), np.random.default_rng(seed)
    period = [motion(k / rate) for k in range(2 * rate)]  # of 2 s
    state, noise = controller.initial_state(), np.zeros(6)
    e, Q = np.zeros((2, rate, 6))
    errors, changes, learnt = [], [], []
    for second in range(seconds):
        for k in range(rate):
            now = second * rate + k
            if now % NOISE_HOLD == 0:
                noise = size * draw.normal(size=6)
            measurement = Measurement(now / rate, data.qpos[qpos_index], data.qvel[qvel_index])
            command, state = controller(state, measurement, period[now % len(period)])
            e[k] = measurement.q - period[now % len(period)].q
            Q[k] = command.force
            data.qfrc_applied[qvel_index] = command.force + noise
            mujoco.mj_step(model, data)
        errors.append(rms(e))
        changes.append(np.mean(np.abs(np.diff(Q, axis=0)), axis=0))
        learnt.append(state)
    return Seconds(np.stack(errors), np.stack(changes), learnt)


def least_trend(values: np.ndarray) -> np.ndarray:
    """Lower end of the interval of the slope of each series along the first axis.

    The slopes of all series are in their intervals together with a probability of 95 %.
    """
    t = np.arange(len(values)) - 0.5 * (len(values) - 1)
    slope = np.tensordot(t, values, 1) / np.sum(t * t)
    rest = values - np.mean(values, axis=0) - np.multiply.outer(t, slope)
    freedom = len(values) - 2
    spread = np.sqrt(np.sum(rest * rest, axis=0) / freedom / np.sum(t * t))
    return slope - stats.t.ppf(1.0 - 0.025 / values[0].size, freedom) * spread


@pytest.mark.parametrize("seconds", [12, pytest.param(120, marks=pytest.mark.slow)])
def test_a_disturbed_arm_stays_within_bounds_and_gets_no_worse(seconds: int):
    controller = hand_set("afsmc", WRONG)
    run = disturbed(controller, seconds)
    assert np.all(np.isfinite(run.error))
    for state in run.learnt:
        assert within_bounds(controller, state._asdict())
        assert np.all(np.diff(state.alpha, axis=-1) >= 0.0)  # no centre overtakes another
    assert np.all(least_trend(run.error[seconds // 2 :]) <= 0.0)
    layer = disturbed(hand_set("smc-boundary", WRONG), 6)
    assert np.all(rms(run.error[2:]) < 0.8 * rms(layer.error[2:]))


@pytest.mark.slow
def test_unbounded_centres_gather_about_zero_and_chatter():
    """30 times faster than recommended, to see in 12 s what else takes minutes."""
    exact = LagrangeModel(P)
    fast = 30.0 * premise_rate(exact)
    gains = {**gains_of(hand_set("afsmc", exact)), "eta3": fast, "eta4": fast}
    loose = {"alpha_max": np.inf, "sigma_min": 0.0, "sigma_max": np.inf}
    kept, free = (disturbed(hand_set("afsmc", WRONG, gains | bounds), 12) for bounds in ({}, loose))
    theta1 = 3
    assert np.max(np.abs(free.learnt[-1].alpha[theta1])) < 0.6  # of 1 at the start
    assert np.mean(free.activity[-4:, theta1]) > 4.0 * np.mean(kept.activity[-4:, theta1])
    assert np.mean(kept.activity[-4:, theta1]) < 1.5 * np.mean(kept.activity[2:6, theta1])

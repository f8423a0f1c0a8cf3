"""The sliding modes against their own theory."""
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false
# (gains are fields of the classes behind the Controller protocol)

import numpy as np
import pytest
from arm_states import (
    REST,
    UNLIMITED,
    P,
    U,
    energy_rate,
    hand_set,
    quadratic,
    random_box,
    random_instant,
    simulated,
)

from controllers.sliding_mode import saturation
from octarm.arm.lagrange import damping_matrix, inverse_dynamics
from octarm.references import SetPoint, named_reference
from octarm.simulation.environment import load
from octarm.simulation.rollout import rollout

# The surface and the switching function


def test_the_surface_is_an_exponential_decay_of_the_error():
    measurement, reference = random_instant(5)
    surface = hand_set("smc", P).surface(measurement, reference)
    e, e_dot = measurement.q - reference.q, measurement.v - reference.v
    np.testing.assert_allclose(surface.s, e_dot + 15.0 * e)
    np.testing.assert_allclose(surface.s, measurement.v - surface.v_r)


def test_saturation_is_a_clipped_line_and_the_sign_without_a_layer():
    s = np.array([-3.0, -1.0, -0.5, 0.0, 1e-9, 0.5, 1.0, 3.0])
    np.testing.assert_array_equal(saturation(s, 2.0), [-1, -0.5, -0.25, 0, 5e-10, 0.25, 0.5, 1])
    np.testing.assert_array_equal(saturation(s, 0.0), np.sign(s))
    layers = np.array([0.0, 2.0] * 4)
    expected = np.where(layers > 0.0, np.clip(s / 2.0, -1.0, 1.0), np.sign(s))
    np.testing.assert_array_equal(saturation(s, layers), expected)


def test_outside_the_layer_and_without_one_the_boundary_layer_is_the_sign_law():
    instant = random_instant(500)
    one = hand_set("smc", P)(None, *instant)[0]
    layer = hand_set("smc-boundary", P)
    two = layer(None, *instant)[0]
    outside = np.abs(one.signals["s"]) >= layer.phi
    assert 0.2 < outside.mean() < 1.0
    np.testing.assert_array_equal(one.force[outside], two.force[outside])
    assert np.all(np.abs(two.signals["switching"]) <= np.abs(one.signals["switching"]))
    none = hand_set("smc-boundary", P, {"phi": 0.0})(None, *instant)[0]
    np.testing.assert_array_equal(none.force, one.force)


# The Lyapunov function, eqs (32)-(42)


@pytest.mark.parametrize("name", ["smc", "smc-boundary"])
def test_the_lyapunov_function_falls_as_the_theory_claims(name: str):
    """V' = s^T (robust part) - s^T B s for the exact model, never positive."""
    controller = hand_set(name, P)
    measurement, reference = random_instant(3000)
    signals = controller(None, measurement, reference)[0].signals
    s, switching = signals["s"], signals["switching"]
    a_r = reference.a - controller.lambda_ * (measurement.v - reference.v)
    rate = energy_rate(P, measurement, s, a_r, signals["equivalent"] + switching)
    claim = np.sum(s * switching, axis=-1) - quadratic(s, damping_matrix(P), s)
    scale = np.max(np.abs(claim))
    np.testing.assert_allclose(rate / scale, claim / scale, atol=1e-10)
    assert np.all(claim <= 0.0)


@pytest.mark.parametrize("name", ["smc", "smc-boundary", "smc-integral"])
def test_a_derived_gain_satisfies_the_sliding_condition_on_every_arm_of_the_box(name: str):
    """(42): V' <= -sum eta |s| - s^T (B + K_v) s, or less by the layer's sum K phi / 4."""
    n = 3000
    nominal = P.scaled(**random_box(P, np.random.default_rng(1), n))
    controller = hand_set(name, nominal, {"uncertainty": U})
    measurement, reference = random_instant(n)
    command, _ = controller(None, measurement, reference)
    if name == "smc-integral":  # the first call starts at s = 0; kick the arm off it
        _, state = controller(None, measurement, reference)
        measurement = measurement._replace(v=measurement.v + 0.9 * random_instant(n, seed=2)[0].v)
        command, _ = controller(state, measurement, reference)
    s, K = command.signals["s"], command.signals["K"]
    e, e_dot = measurement.q - reference.q, measurement.v - reference.v
    if name == "smc-integral":
        a_r = reference.a - 2.0 * 15.0 * e_dot - 15.0**2 * e
    else:
        a_r = reference.a - 15.0 * e_dot
    rate = energy_rate(P, measurement, s, a_r, command.force)
    damped = quadratic(s, damping_matrix(P), s) + np.sum(controller.K_v * s * s, axis=-1)
    bound = -np.sum(controller.eta * np.abs(s), axis=-1) - damped
    if name != "smc":
        bound += np.sum(0.25 * K * controller.phi, axis=-1)
    assert np.all(rate - bound < 1e-9 * np.max(np.abs(rate)))
    assert np.mean(np.abs(s) > 0.01 * controller.phi if name != "smc" else s != 0.0) > 0.9


# The boundary layer


def test_a_boundary_layer_trades_chattering_for_accuracy():
    runs = {
        name: rollout(load(), hand_set(name, P.mismatched(-0.3)), 2.0)
        for name in ("smc", "smc-boundary")
    }
    rms = {n: np.sqrt(np.mean(r.error[r.t > 1.0, 3:5] ** 2)) for n, r in runs.items()}
    switching = {n: np.mean(np.abs(np.diff(r.force, axis=0)), axis=0) for n, r in runs.items()}
    assert rms["smc"] < 0.5 * rms["smc-boundary"]
    assert np.all(switching["smc"] > 50.0 * switching["smc-boundary"])


LOAD = np.array([0.5, 0.3, 0.2, 0.1, 0.05, 0.005])  # within K [N], [N m]


def test_under_a_constant_load_the_layer_keeps_an_error_and_the_integral_none():
    """At rest (B^ + K_v + K / phi) lambda e = load in the layer; the integral makes e = 0."""
    boundary = hand_set("smc-boundary", P)
    _, error, _ = simulated(boundary, SetPoint(q=REST), 1.5, load=LOAD)
    slope = damping_matrix(P) + np.diag(boundary.K_v + boundary.K / boundary.phi)
    np.testing.assert_allclose(error[-1], np.linalg.solve(slope, LOAD) / 15.0, rtol=1e-3)
    integral = hand_set("smc-integral", P)
    _, error, signals = simulated(integral, SetPoint(q=REST), 1.5, load=LOAD)
    assert np.all(np.abs(error[-1]) < 1e-6 * np.max(np.abs(error), axis=0))
    np.testing.assert_allclose(15.0**2 * signals[-1]["integral"], signals[-1]["s"], rtol=1e-3)


# The integral surface, eqs (10), (24), (25)


def test_on_the_integral_surface_the_error_has_a_double_pole():
    """There from the first call on: e = (e0 + (e0' + lambda e0) t) exp(-lambda t), no reaching."""
    start = REST + np.array([0.01, -0.01, 0.005, 0.2, -0.1, 0.1])
    controller = hand_set("smc-integral", P)
    motion = named_reference("sine", REST)
    t, error, signals = simulated(controller, motion, 0.4, start=start, dt=2.5e-4)
    e, e_dot = start - motion(0.0).q, -motion(0.0).v
    expected = (e + (e_dot + 15.0 * e) * t[:, None]) * np.exp(-15.0 * t[:, None])
    np.testing.assert_array_equal(signals[0]["s"], 0.0)
    np.testing.assert_allclose(error, expected, atol=5e-3 * np.max(np.abs(expected)))


def test_the_integral_surface_as_printed_is_unstable():
    """(24): (1 + 2 lambda) e' - lambda^2 e; corrected: the double pole."""
    for lambda_ in (5.0, 15.0):
        assert np.roots([1.0 + 2.0 * lambda_, -(lambda_**2)])[0] > 0.0
        np.testing.assert_allclose(np.roots([1.0, 2.0 * lambda_, lambda_**2]), -lambda_, rtol=1e-6)


def test_the_integral_does_not_wind_up_while_the_actuators_are_at_their_limits():
    """After a second under a load that they cannot hold, the arm is back in half a second."""
    limit = np.array([4.0, 3.0, 2.0, 0.6, 0.3, 0.05])
    undershoot = {}
    for name, gains in (("given", {}), ("none", {"s_max": 1e6})):
        controller = hand_set("smc-integral", P, gains)
        t, error, signals = simulated(
            controller, SetPoint(q=REST), 2.0, load=20.0 * LOAD, until=1.0, limit=limit
        )
        held, back = np.max(np.abs(error[t < 1.0]), axis=0), error[t >= 1.75]
        assert np.all(held[3:5] > 0.3)
        undershoot[name] = np.max(np.abs(back), axis=0) / held
        s = np.abs([one["s"] for one in signals])
        assert np.all(s <= controller.s_max * (1.0 + 1e-12))
        assert np.any(s > 10.0) == (name == "none")
    assert np.all(undershoot["given"][3:5] < 0.01)
    assert np.all(undershoot["none"][3:5] > 0.3)


# Super-twisting


def test_sampling_leaves_the_sign_law_first_and_super_twisting_second_order_chattering():
    """Half the period: half and a quarter of s; the same and half the jumps of the force."""
    s, jumps = {}, {}
    for name in ("smc", "super-twisting"):
        for period in (1e-3, 5e-4):
            run = rollout(load(timestep=period), hand_set(name, P.mismatched(-0.3)), 1.5)
            assert run.status == "ok"
            late = run.t >= 0.75
            s[name, period] = np.sqrt(np.mean(run.signals["s"][late] ** 2, axis=0))
            jumps[name, period] = np.mean(np.abs(np.diff(run.force[late], axis=0)), axis=0)
    for name, order in (("smc", 1), ("super-twisting", 2)):
        measured = np.log2(s[name, 1e-3] / s[name, 5e-4])
        np.testing.assert_allclose(measured, order, atol=0.4)
    assert np.all(s["super-twisting", 5e-4] < 0.02 * s["smc", 5e-4])
    assert np.all(jumps["super-twisting", 5e-4] < 0.02 * jumps["smc", 5e-4])


@pytest.mark.parametrize("mismatch", [-0.3, 0.3])
def test_super_twisting_finds_the_model_error(mismatch: float):
    """On s = 0, s' = 0 the switching part is minus the error of the model."""
    nominal = P.mismatched(mismatch)
    run = rollout(load(), hand_set("super-twisting", nominal), 1.5)
    motion = named_reference("sine", REST)
    late = run.t >= 0.75
    a_d = np.array([motion(t).a for t in run.t[late]])
    q, v, switching = run.q[late], run.v[late], run.signals["switching"][late]
    F = inverse_dynamics(nominal, q, v, a_d) - inverse_dynamics(P, q, v, a_d)
    missed = np.sqrt(np.mean((switching + F) ** 2, axis=0))
    assert np.all(missed[:5] < 0.02 * np.max(np.abs(F[:, :5]), axis=0))
    assert np.max(np.abs(run.signals["w"][late] - switching[:, :])) < 0.1


@pytest.mark.parametrize("mismatch", [-0.3, 0.3])
def test_recommended_gains_exceed_the_model_error_and_its_rate_on_the_default_reference(
    mismatch: float,
):
    motion = named_reference("sine", REST)
    times = np.linspace(0.0, 2.0, 2001)
    q, v, a = (np.stack(part) for part in zip(*map(motion, times), strict=True))
    F = inverse_dynamics(P.mismatched(mismatch), q, v, a) - inverse_dynamics(P, q, v, a)
    assert np.all(np.max(np.abs(F), axis=0) < hand_set("smc", P).K)
    rate = np.max(np.abs(np.diff(F, axis=0)), axis=0) / times[1]
    assert np.all(rate < hand_set("super-twisting", P).k_2)


def test_super_twisting_integrates_the_sign_of_s():
    """w' = -k_2 sgn(s), and w is in the force as it stands."""
    controller = hand_set("super-twisting", UNLIMITED, {"K": 1e6})
    (measurement, reference), dt = random_instant(50), 0.05
    state = controller.initial_state((50,))
    w = np.zeros((50, 6))
    for k in range(4):
        command, state = controller(state, measurement._replace(t=k * dt), reference)
        s, root = command.signals["s"], np.sqrt(np.abs(command.signals["s"]))
        robust = -controller.k_1 * root * np.sign(s) - controller.K_v * s + w
        np.testing.assert_allclose(command.signals["switching"], robust, rtol=1e-9)
        w = -controller.k_2 * np.sign(s) * k * dt
        np.testing.assert_allclose(state.w, w, rtol=1e-9)


def test_super_twisting_does_not_wind_up():
    controller = hand_set("super-twisting", P)
    _, _, signals = simulated(controller, SetPoint(q=REST), 0.5, load=20.0 * LOAD)
    w = np.abs([one["w"] for one in signals])
    np.testing.assert_array_equal(np.max(w, axis=0), controller.K)

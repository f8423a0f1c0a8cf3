"""The fuzzy controller and fuzzy sliding mode, against their own theory and on the arm."""
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false
# (gains are fields of the classes behind the Controller protocol)

import dataclasses
from typing import ClassVar

import numpy as np
import pytest
from arm_states import hand_set

from controllers.fuzzy.inference import Mamdani, Variable
from controllers.fuzzy.membership import Triangular
from controllers.fuzzy_rules import LEVELS, RULES, SWITCHING, FuzzyController, error_scale
from controllers.recommended import apparent_mass
from octarm.arm.lagrange import (
    damping_matrix,
    equilibrium,
    forward_dynamics,
    mass_matrix,
    potential_hessian,
)
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.nominal import LagrangeModel
from octarm.interfaces import Measurement, Reference
from octarm.simulation.environment import load
from octarm.simulation.rollout import rollout
from octarm.simulation.trajectory import Trajectory

P = nominal_parameters()
AMPLITUDE = np.array([0.35, 0.25])  # of theta1 and theta2 on the default sine [rad]
NAMES = ["fuzzy", "fsmc"]


def random_instant(n: int, size: float = 1.0, seed: int = 0) -> tuple[Measurement, Reference]:
    draw = np.random.default_rng(seed)
    scale = size * np.repeat([0.02, 0.3], 3)
    q, q_d = (equilibrium(P) + scale * draw.normal(size=(n, 6)) for _ in range(2))
    v, v_d, a_d = (10.0 * scale * draw.normal(size=(n, 6)) for _ in range(3))
    return Measurement(0.0, q, v), Reference(q_d, v_d, a_d)


def settled_rms(run: Trajectory, after: float = 2.0) -> np.ndarray:
    return np.sqrt(np.mean(run.error[run.t > after] ** 2, axis=0))


class MamdaniFuzzy(FuzzyController):
    """The recommended rules with Mamdani's sets."""

    surface: ClassVar = Mamdani(
        inputs=tuple(Variable.uniform(name, tuple(LEVELS)) for name in ("e", "rate")),
        output=Variable("u", {n: Triangular(p - 1 / 3, p, p + 1 / 3) for n, p in LEVELS.items()}),
        rules=RULES,
        universe=np.linspace(-4 / 3, 4 / 3, 81),
    )


# The pure fuzzy controller


@pytest.mark.parametrize("first", [True, False])
def test_the_surface_is_called_with_the_error_then_its_rate(first: bool):
    class One(FuzzyController):
        surface: ClassVar = staticmethod(lambda e, rate: e if first else rate)

    plain, (m, r) = hand_set("fuzzy", P), random_instant(5)
    controller = One(**{f.name: getattr(plain, f.name) for f in dataclasses.fields(plain)})
    scaled = (m.q - r.q) / plain.e_scale if first else (m.v - r.v) / plain.rate_scale
    np.testing.assert_allclose(controller(None, m, r)[0].force, -plain.force_scale * scaled)


def test_fuzzy_knows_no_model():
    """Another nominal model gives the same force for the same gains [SI]."""
    instant = random_instant(20)
    forces = [80.0, 40.0, 30.0, 12.0, 2.5, 0.9]
    gains = {"force_scale": forces, "e_scale": 0.03, "rate_scale": 6.0}
    models = (P, P.mismatched(-0.3))
    one, two = (hand_set("fuzzy", p, gains)(None, *instant)[0] for p in models)
    np.testing.assert_array_equal(one.force, two.force)


def test_fuzzy_is_a_pd_law_for_small_errors_and_bounded_for_large_ones():
    controller = hand_set("fuzzy", P)
    m, r = random_instant(500, size=0.04)
    e, e_dot = m.q - r.q, m.v - r.v
    pd = -controller.force_scale * (e / controller.e_scale + e_dot / controller.rate_scale)
    small = np.abs(e / controller.e_scale) + np.abs(e_dot / controller.rate_scale) <= 2 / 3
    np.testing.assert_allclose(controller(None, m, r)[0].force[small], pd[small], atol=1e-10)
    assert 0.5 < np.mean(small) < 1.0

    command, _ = controller(None, *random_instant(500, size=10.0))
    assert np.all(np.abs(command.force) <= controller.force_scale * (1.0 + 1e-12))
    assert np.mean(np.abs(command.signals["fuzzy"]) > 0.999) > 0.3


def test_fuzzy_does_not_push_on_the_diagonal_of_its_table():
    """Where s = e' + (rate_scale / e_scale) e is zero, so is the force; else it opposes s."""
    controller = hand_set("fuzzy", P)
    m, r = random_instant(500)
    ratio = controller.rate_scale / controller.e_scale
    sliding = Measurement(0.0, m.q, r.v - ratio * (m.q - r.q))
    np.testing.assert_allclose(controller(None, sliding, r)[0].force, 0.0, atol=1e-9)
    command, _ = controller(None, m, r)
    s = command.signals["s"]
    np.testing.assert_allclose(s, m.v - r.v + ratio * (m.q - r.q))
    assert np.all(s * command.force <= 1e-12)


def test_fuzzy_holds_a_pose_with_the_error_that_the_springs_ask_for():
    """At rest -force_scale e / e_scale = G(q), about (dG/dq) (q_d - q_0) for a small step."""
    controller = hand_set("fuzzy", P)
    rest = equilibrium(P)
    step = np.array([0.002, 0.002, 0.002, 0.02, 0.02, 0.02])
    still = np.zeros(6)
    run = rollout(load(lambda t: Reference(rest + step, still, still)), controller, 1.5)
    K_p = np.diag(controller.force_scale / controller.e_scale)
    stiffness = potential_hessian(P, rest)
    error = -np.linalg.solve(K_p + stiffness, stiffness @ step)
    np.testing.assert_allclose(run.error[-1], error, rtol=0.02, atol=1e-6)


@pytest.mark.parametrize(("mismatch", "duration"), [(-0.3, 1.5), (0.0, 2.0), (0.3, 1.5)])
def test_fuzzy_tracks_the_default_reference_with_any_arm(mismatch: float, duration: float):
    """Gains hand-set for the nominal arm: 0.8 % and 3 % of the amplitudes there."""
    arm = P.mismatched(mismatch)
    run = rollout(load(parameters=arm), hand_set("fuzzy", P), duration)
    assert run.status == "ok"
    rms = settled_rms(run, after=0.5 * duration)
    assert np.all(rms[3:5] < np.array([0.012, 0.04]) * AMPLITUDE)
    assert np.all(rms[:3] < 1e-4) and rms[5] < 1e-3


def test_mamdani_rules_serve_the_same_controller():
    plain = hand_set("fuzzy", P)
    gains = {f.name: getattr(plain, f.name) for f in dataclasses.fields(plain)}
    run = rollout(load(), MamdaniFuzzy(**gains), 0.75)
    assert run.status == "ok"
    assert np.all(settled_rms(run, after=0.25)[3:5] < 0.05 * AMPLITUDE)


def test_the_hand_set_forces_follow_the_rule_for_other_arms():
    force, model = hand_set("fuzzy", P).force_scale, LagrangeModel(P)
    scaled = 300.0**2 * apparent_mass(model) * error_scale(model)
    np.testing.assert_allclose(force, scaled, rtol=0.1)
    two = dataclasses.replace(
        P,
        **{f: getattr(P, f)[..., :2] for f in ("mass", "inertia", "rest_length")},
        **{f: getattr(P, f)[..., :2] for f in ("stiffness", "damping")},
    )
    assert hand_set("fuzzy", two).force_scale.shape == (4,)


# Fuzzy sliding mode


def test_the_switching_function_is_odd_rises_and_saturates():
    s = np.linspace(-1.5, 1.5, 601)
    f = SWITCHING(s)
    np.testing.assert_allclose(f, -f[::-1], atol=1e-12)
    inside = np.abs(s) < 1.0
    assert np.all(np.diff(f[inside]) > 0.0)
    np.testing.assert_allclose(f[~inside], np.sign(s[~inside]), rtol=1e-12)
    # Steeper than the boundary layer near zero, never weaker than it inside.
    assert np.all(np.abs(f[inside]) >= np.abs(s[inside]) - 1e-12)
    assert np.all(np.diff(f, 2)[s[1:-1] > 0.0] <= 1e-12)


def test_outside_the_layer_fsmc_is_the_sign_law():
    sign, fuzzy = hand_set("smc", P), hand_set("fsmc", P)
    instant = random_instant(500)
    one, two = sign(None, *instant)[0], fuzzy(None, *instant)[0]
    outside = np.abs(one.signals["s"]) >= fuzzy.phi
    assert 0.2 < outside.mean() < 1.0
    np.testing.assert_allclose(one.force[outside], two.force[outside], rtol=1e-12)
    np.testing.assert_array_equal(one.signals["equivalent"], two.signals["equivalent"])
    np.testing.assert_array_equal(two.force, two.signals["equivalent"] + two.signals["switching"])


def test_the_lyapunov_function_of_fsmc_falls_as_claimed():
    """V = 1/2 s'Ds: V' = s'(switching) - s'Bs for the exact model, never positive."""
    controller = hand_set("fsmc", P)
    measurement, reference = random_instant(3000)
    command, _ = controller(None, measurement, reference)
    q, v, s = measurement.q, measurement.v, command.signals["s"]
    a = forward_dynamics(P, q, v, command.force)
    s_dot = a - (reference.a - controller.lambda_ * (v - reference.v))
    h = 1e-6  # along the motion, by central differences of the reported V
    V = [
        0.5 * np.einsum("ni,nij,nj->n", x, mass_matrix(P, at), x)
        for x, at in ((s + h * s_dot, q + h * v), (s - h * s_dot, q - h * v))
    ]
    V_dot = (V[0] - V[1]) / (2.0 * h)
    claim = np.sum(s * command.signals["switching"], axis=-1)
    claim = claim - np.einsum("ni,ij,nj->n", s, damping_matrix(P), s)
    scale = np.max(np.abs(claim))
    np.testing.assert_allclose(V_dot / scale, claim / scale, atol=1e-7)
    assert np.all(claim <= 0.0)
    reported = command.signals["V"]
    assert reported.shape == (3000, 1)
    now = 0.5 * np.einsum("ni,nij,nj->n", s, mass_matrix(P, q), s)
    np.testing.assert_allclose(reported[:, 0], now)


def test_fsmc_tracks_below_one_percent_with_the_exact_model():
    rms = settled_rms(rollout(load(), hand_set("fsmc", P), 2.0), after=1.0)
    assert np.all(rms[3:5] < 0.01 * AMPLITUDE)
    assert np.all(rms[:3] < 1e-5) and rms[5] < 1e-3


@pytest.mark.parametrize("mismatch", [-0.3, 0.3])
def test_fsmc_is_more_accurate_than_the_boundary_layer_and_as_smooth(mismatch: float):
    fuzzy, layer, sign = (
        rollout(load(), hand_set(name, P.mismatched(mismatch)), 1.5)
        for name in ("fsmc", "smc-boundary", "smc")
    )
    assert np.all(settled_rms(fuzzy, 0.5)[3:5] < 0.8 * settled_rms(layer, 0.5)[3:5])
    moved = [
        np.mean(np.abs(np.diff(run.force[run.t > 0.5], axis=0)), axis=0)
        for run in (fuzzy, layer, sign)
    ]
    assert np.all(moved[0] < 2.0 * moved[1]) and np.all(moved[0] < 0.02 * moved[2])


# Both


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("n", [1, 2, 5])
def test_signals_have_the_declared_shapes_for_any_number_of_modules(name: str, n: int):
    arm = dataclasses.replace(
        P,
        **{f: np.repeat(getattr(P, f)[..., :1], n, axis=-1) for f in ("mass", "inertia")},
        **{f: np.repeat(getattr(P, f)[..., :1], n, axis=-1) for f in ("stiffness", "damping")},
        rest_length=np.repeat(P.rest_length[:1], n),
    )
    draw = np.random.default_rng(0).normal(size=(5, 4, 3, 2 * n))
    command, state = hand_set(name, arm)(
        None, Measurement(0.0, draw[0], draw[1]), Reference(*draw[2:])
    )
    assert state is None and command.force.shape == (4, 3, 2 * n)
    for key, signal in command.signals.items():
        assert signal.shape == (4, 3, 1 if key == "V" else 2 * n)
        assert np.all(np.isfinite(signal))
        assert not np.shares_memory(signal, command.force)


@pytest.mark.parametrize(
    ("name", "gain", "message"),
    [
        ("fuzzy", {"e_scale": 0.0}, "e_scale holds 0; it must be above 0"),
        ("fuzzy", {"rate_scale": [1.0, 2.0]}, "rate_scale has 2 values; it needs 1 or 6"),
        ("fuzzy", {"force": 1.0}, "fuzzy has no gain 'force', did you mean 'force_scale'"),
        ("fsmc", {"phi": 0.0}, "phi holds 0; it must be above 0"),
        ("fsmc", {"K": -1.0}, "K holds -1; it must be at least 0"),
        ("fsmc", {"lambda": np.nan}, "lambda holds nan; it must be finite"),
    ],
)
def test_bad_gains_are_refused_in_one_sentence(name: str, gain: dict, message: str):
    with pytest.raises(ValueError, match=message):
        hand_set(name, P, gain)


@pytest.mark.parametrize("name", NAMES)
def test_a_wrong_shape_is_refused(name: str):
    m, r = random_instant(4)
    with pytest.raises(ValueError, match=r"q has shape \(4, 4\)"):
        hand_set(name, P)(None, Measurement(0.0, m.q[:, :4], m.v), r)

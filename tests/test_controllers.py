"""Controllers against their own theory."""
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false
# (gains are fields of the classes behind the Controller protocol)

import dataclasses

import numpy as np
import pytest

from controllers import CONTROLLERS, make_controller
from octarm.environment import load
from octarm.interfaces import Measurement, Reference
from octarm.lagrange import (
    coriolis_matrix,
    damping_matrix,
    equilibrium,
    forward_dynamics,
    inverse_dynamics,
    mass_matrix,
    stiffness_matrix,
)
from octarm.model import nominal_parameters
from octarm.parameters import ArmParameters
from octarm.references import named_reference
from octarm.rollout import rollout

P = nominal_parameters()


def random_instant(batch: tuple[int, ...], seed: int = 0) -> tuple[Measurement, Reference]:
    draw = np.random.default_rng(seed)
    scale = np.repeat([0.05, 0.5], 3)
    q = equilibrium(P) + scale * draw.normal(size=(*batch, 6))
    v, v_d, a_d = (10.0 * scale * draw.normal(size=(*batch, 6)) for _ in range(3))
    q_d = equilibrium(P) + scale * draw.normal(size=(*batch, 6))
    return Measurement(0.3, q, v), Reference(q_d, v_d, a_d)


def taken(measurement: Measurement, reference: Reference, index) -> tuple[Measurement, Reference]:
    return (
        Measurement(measurement.t, measurement.q[index], measurement.v[index]),
        Reference(*(part[index] for part in reference)),
    )


@pytest.mark.parametrize("name", CONTROLLERS)
def test_one_arm_equals_its_row_of_a_batch_bit_for_bit(name: str):
    controller = make_controller(name, P.mismatched(-0.3))
    instant = random_instant((257,))
    command, _ = controller(controller.initial_state((257,)), *instant)
    fortran = (
        Measurement(0.3, *map(np.asfortranarray, instant[0][1:])),
        Reference(*map(np.asfortranarray, instant[1])),
    )
    contiguous, _ = controller(controller.initial_state((257,)), *fortran)
    np.testing.assert_array_equal(command.force, contiguous.force)
    for i in (0, 1, 128, 256):
        single, _ = controller(controller.initial_state(), *taken(*instant, i))
        np.testing.assert_array_equal(single.force, command.force[i])
        for key, signal in single.signals.items():
            np.testing.assert_array_equal(signal, command.signals[key][i])


@pytest.mark.parametrize("name", CONTROLLERS)
def test_controllers_are_pure(name: str):
    controller = make_controller(name, P)
    instant = random_instant((4,))
    copies = [part.copy() for part in (*instant[0][1:], *instant[1])]
    first, _ = controller(controller.initial_state((4,)), *instant)
    second, _ = controller(controller.initial_state((4,)), *instant)
    np.testing.assert_array_equal(first.force, second.force)
    for part, copy in zip((*instant[0][1:], *instant[1]), copies, strict=True):
        np.testing.assert_array_equal(part, copy)
    with pytest.raises(dataclasses.FrozenInstanceError):
        controller.nominal = P


@pytest.mark.parametrize("name", CONTROLLERS)
@pytest.mark.parametrize("modules", [1, 2, 5])
def test_any_number_of_modules(name: str, modules: int):
    n = np.ones(modules)
    arm = ArmParameters(
        mass=0.2 * n,
        inertia=5e-4 * n,
        width=0.08,
        stiffness=1000.0 * np.ones((2, modules)),
        damping=10.0 * np.ones((2, modules)),
        rest_length=0.1 * n,
        gravity=9.81,
    )
    run = rollout(load(parameters=arm), make_controller(name, arm), 0.5)
    assert run.status == "ok"
    assert np.max(np.abs(run.error[-200:])) < 0.03


@pytest.mark.parametrize("name", CONTROLLERS)
def test_gains_broadcast_along_the_batch(name: str):
    plain = make_controller(name, P)
    gains = {
        f.name.rstrip("_"): np.stack([getattr(plain, f.name) * np.ones(6)] * 3)
        for f in dataclasses.fields(plain)
        if f.name != "nominal"
    }
    many = make_controller(name, P, gains)
    instant = random_instant((3,))
    np.testing.assert_array_equal(many(None, *instant)[0].force, plain(None, *instant)[0].force)


def test_computed_torque_makes_the_error_linear():
    """With an exact model, e'' + K_d e' + K_p e = 0 at every state."""
    controller = make_controller("computed-torque", P)
    measurement, reference = random_instant((200,))
    command, _ = controller(None, measurement, reference)
    a = forward_dynamics(P, measurement.q, measurement.v, command.force)
    e, e_dot, e_ddot = measurement.q - reference.q, measurement.v - reference.v, a - reference.a
    residual = e_ddot + controller.K_d * e_dot + controller.K_p * e
    np.testing.assert_allclose(residual, 0.0, atol=1e-9 * np.max(np.abs(a)))


def test_computed_torque_falls_over_when_it_cancels_springs_that_are_not_there():
    """15 % too much stiffness is cancelled: stable only if (1 + 0.3) K_p exceeds 0.15 D^-1 K."""
    q = equilibrium(P)
    modes = np.linalg.eigvals(np.linalg.solve(mass_matrix(P, q), stiffness_matrix(P)))
    least = 0.15 * np.max(modes.real) / 1.3
    for K_p, status in ((0.5 * least, "diverged"), (2.0 * least, "ok")):
        gains = {"K_p": K_p, "K_d": 2.0 * np.sqrt(K_p)}
        controller = make_controller("computed-torque", P.mismatched(0.3), gains)
        assert rollout(load(), controller, 2.0).status == status
    assert make_controller("computed-torque", P).K_p > 1.5 * least


@pytest.mark.parametrize("name", ["smc", "smc-boundary"])
def test_the_lyapunov_function_falls_as_the_theory_claims(name: str):
    """V = 1/2 s'Ds: V' = s'(robust part) - s'Bs for the exact model, never positive."""
    controller = make_controller(name, P)
    measurement, reference = random_instant((3000,))
    command, _ = controller(None, measurement, reference)
    q, v, s = measurement.q, measurement.v, command.signals["s"]
    D, C, B = mass_matrix(P, q), coriolis_matrix(P, q, v), damping_matrix(P)
    a = forward_dynamics(P, q, v, command.force)
    s_dot = a - (reference.a - controller.lambda_ * (v - reference.v))
    h = 1e-6  # D' along the motion, by central differences
    D_dot = (mass_matrix(P, q + h * v) - mass_matrix(P, q - h * v)) / (2.0 * h)
    V_dot = np.einsum("ni,nij,nj->n", s, D, s_dot) + 0.5 * np.einsum("ni,nij,nj->n", s, D_dot, s)
    claim = np.sum(s * command.signals["switching"], axis=-1) - np.einsum("ni,ij,nj->n", s, B, s)
    scale = np.max(np.abs(claim))
    np.testing.assert_allclose(V_dot / scale, claim / scale, atol=1e-8)
    assert np.all(claim <= 0.0)
    assert C.shape == D.shape


@pytest.mark.parametrize("mismatch", [-0.3, 0.3])
def test_the_switching_gain_exceeds_the_model_error_on_the_default_reference(mismatch: float):
    motion = named_reference("sine", equilibrium(P))
    q, v, a = (np.stack(part) for part in zip(*map(motion, np.linspace(0, 2, 201)), strict=True))
    wrong = inverse_dynamics(P.mismatched(mismatch), q, v, a) - inverse_dynamics(P, q, v, a)
    assert np.all(np.max(np.abs(wrong), axis=0) < make_controller("smc", P).K)


def test_the_surface_is_an_exponential_decay_of_the_error():
    controller = make_controller("smc", P)
    measurement, reference = random_instant((5,))
    s = controller(None, measurement, reference)[0].signals["s"]
    e, e_dot = measurement.q - reference.q, measurement.v - reference.v
    np.testing.assert_allclose(s, e_dot + 15.0 * e)


def test_outside_the_layer_the_boundary_layer_is_the_sign_law():
    sign, layer = make_controller("smc", P), make_controller("smc-boundary", P)
    measurement, reference = random_instant((500,))
    one, two = sign(None, measurement, reference)[0], layer(None, measurement, reference)[0]
    outside = np.abs(one.signals["s"]) >= layer.phi
    assert 0.2 < outside.mean() < 1.0
    np.testing.assert_array_equal(one.force[outside], two.force[outside])
    assert np.all(np.abs(two.signals["switching"]) <= np.abs(one.signals["switching"]))


@pytest.mark.parametrize("name", CONTROLLERS)
def test_the_exact_model_tracks_the_default_reference_below_one_percent(name: str):
    run = rollout(load(), make_controller(name, P), 4.0)
    rms = np.sqrt(np.mean(run.error[run.t > 2.0] ** 2, axis=0))
    assert np.all(rms[3:5] < 0.01 * np.array([0.35, 0.25]))
    assert np.all(rms[:3] < 1e-5) and rms[5] < 1e-3


def test_a_boundary_layer_trades_chattering_for_accuracy():
    runs = {
        name: rollout(load(), make_controller(name, P.mismatched(-0.3)), 3.0)
        for name in ("smc", "smc-boundary")
    }
    rms = {n: np.sqrt(np.mean(r.error[r.t > 2.0, 3:5] ** 2)) for n, r in runs.items()}
    switching = {n: np.mean(np.abs(np.diff(r.force, axis=0)), axis=0) for n, r in runs.items()}
    assert rms["smc"] < 0.5 * rms["smc-boundary"]
    assert np.all(switching["smc"] > 50.0 * switching["smc-boundary"])


@pytest.mark.parametrize(
    ("gain", "message"),
    [
        ({"K": np.nan}, "K holds nan; it must be finite"),
        ({"K": [1.0, 2.0]}, "K has 2 values; it needs 1 or 6, one for each coordinate"),
        ({"lambda": -3.0}, "lambda holds -3; it must be above 0"),
        ({"phi": 0.0}, "phi holds 0; it must be above 0"),
        ({"phy": 1.0}, "smc-boundary has no gain 'phy', did you mean 'phi'"),
        ({"K": "big"}, "K is 'big'; it must be made of numbers"),
    ],
)
def test_bad_gains_are_refused_in_one_sentence(gain: dict, message: str):
    with pytest.raises(ValueError, match=message):
        make_controller("smc-boundary", P, gain)


def test_unknown_controllers_list_the_known_ones():
    with pytest.raises(
        ValueError, match=r"unknown controller 'smk', did you mean 'smc'.*smc-boundary"
    ):
        make_controller("smk", P)

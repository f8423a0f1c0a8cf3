"""The table of names, the gains, and the controllers without a sliding surface."""
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false
# (gains are fields of the classes behind the Controller protocol)

import numpy as np
import pytest
from arm_states import hand_set

from controllers.law import elapsed
from octarm.arm.lagrange import (
    equilibrium,
    forward_dynamics,
    mass_matrix,
    potential_force,
    potential_hessian,
    stiffness_matrix,
)
from octarm.arm.mjcf import nominal_parameters
from octarm.interfaces import Measurement, Reference
from octarm.references import SetPoint
from octarm.simulation.environment import load
from octarm.simulation.rollout import rollout

P = nominal_parameters()
REST = equilibrium(P)


def random_instant(n: int) -> tuple[Measurement, Reference]:
    draw = np.random.default_rng(0)
    scale = np.repeat([0.05, 0.5], 3)
    q, q_d = (REST + scale * draw.normal(size=(n, 6)) for _ in range(2))
    v, v_d, a_d = (10.0 * scale * draw.normal(size=(n, 6)) for _ in range(3))
    return Measurement(0.3, q, v), Reference(q_d, v_d, a_d)


def test_computed_torque_makes_the_error_linear():
    """With an exact model, e'' + K_d e' + K_p e = 0 at every state."""
    controller = hand_set("computed-torque", P)
    measurement, reference = random_instant(200)
    command, _ = controller(None, measurement, reference)
    a = forward_dynamics(P, measurement.q, measurement.v, command.force)
    e, e_dot, e_ddot = measurement.q - reference.q, measurement.v - reference.v, a - reference.a
    residual = e_ddot + controller.K_d * e_dot + controller.K_p * e
    np.testing.assert_allclose(residual, 0.0, atol=1e-9 * np.max(np.abs(a)))
    feedback = -controller.K_d * command.signals["s"]
    np.testing.assert_allclose(e_ddot, feedback, rtol=1e-9, atol=1e-9 * np.max(np.abs(a)))


def test_computed_torque_falls_over_when_it_cancels_springs_that_are_not_there():
    """15 % too much stiffness is cancelled: stable only if (1 + 0.3) K_p exceeds 0.15 D^-1 K."""
    modes = np.linalg.eigvals(np.linalg.solve(mass_matrix(P, REST), stiffness_matrix(P)))
    least = 0.15 * np.max(modes.real) / 1.3
    for K_p, status in ((0.5 * least, "diverged"), (2.0 * least, "ok")):
        gains = {"K_p": K_p, "K_d": 2.0 * np.sqrt(K_p)}
        controller = hand_set("computed-torque", P.mismatched(0.3), gains)
        assert rollout(load(), controller, 2.0).status == status
    assert hand_set("computed-torque", P).K_p > 1.5 * least


def test_pd_holds_the_arm_where_it_shall_be():
    controller = hand_set("pd", P)
    measurement, reference = random_instant(200)
    there = Measurement(0.0, reference.q, reference.v)
    force = controller(None, there, reference)[0].force
    np.testing.assert_allclose(force, potential_force(P, reference.q), rtol=1e-9)
    signals = controller(None, measurement, reference)[0].signals
    e, e_dot = measurement.q - reference.q, measurement.v - reference.v
    expected = -controller.K_p * e - controller.K_d * e_dot
    np.testing.assert_allclose(signals["feedback"], expected)
    np.testing.assert_allclose(-controller.K_d * signals["s"], expected, rtol=1e-9)

    bent = REST + np.array([0.01, 0.0, -0.01, 0.4, -0.3, 0.2])
    run = rollout(load(SetPoint(q=bent)), controller, 3.0)
    assert np.max(np.abs(run.error[-1])) < 1e-3 * np.max(np.abs(run.error[0]))


def test_pd_bears_a_model_that_is_far_too_stiff():
    """G^(q_d) pushes but does not cancel; G^(q) would leave a negative stiffness behind."""
    too_stiff = P.scaled(stiffness=3.0)
    weak = {"K_p": 0.5 * np.diag(stiffness_matrix(P))}
    run = rollout(load(), hand_set("pd", too_stiff, weak), 2.0)
    assert run.status == "ok"
    left = potential_hessian(P, REST) + np.diag(weak["K_p"])
    assert np.min(np.linalg.eigvalsh(left)) > 0.0
    assert np.max(np.linalg.eigvalsh(left - potential_hessian(too_stiff, REST))) < 0.0


def test_pd_pushes_back_as_hard_as_the_boundary_layer():
    """Its gains are those inside the recommended layer, so that the two can be compared."""
    pd, layer = hand_set("pd", P), hand_set("smc-boundary", P)
    np.testing.assert_allclose(pd.K_d, layer.K_v + layer.K / layer.phi)
    np.testing.assert_allclose(pd.K_p, layer.lambda_ * pd.K_d)


@pytest.mark.parametrize(
    ("gain", "message"),
    [
        ({"K": np.nan}, "K holds nan; it must be finite"),
        ({"K": [1.0, 2.0]}, "K has 2 values; it needs 1 or 6, one for each coordinate"),
        ({"lambda": -3.0}, "lambda holds -3; it must be above 0"),
        ({"phi": -1.0}, "phi holds -1; it must be at least 0"),
        ({"phy": 1.0}, "smc-boundary has no gain 'phy', did you mean 'phi'"),
        ({"K": "big"}, "K is 'big'; it must be made of numbers"),
    ],
)
def test_bad_gains_are_refused_in_one_sentence(gain: dict, message: str):
    with pytest.raises(ValueError, match=message):
        hand_set("smc-boundary", P, gain)


def test_unknown_controllers_list_the_known_ones():
    with pytest.raises(
        ValueError, match=r"unknown controller 'smk', did you mean 'smc'.*smc-boundary"
    ):
        hand_set("smk", P)


def test_time_that_goes_back_is_refused():
    assert elapsed(1.0, 1.5) == 0.5
    with pytest.raises(ValueError, match=r"t is 0\.5 s after 1 s; time must not go back"):
        elapsed(1.0, 0.5)

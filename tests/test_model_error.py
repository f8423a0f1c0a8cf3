"""The gain derived from a declared uncertainty, eq (40), and the time to reach the surface."""
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false
# (gains are fields of the classes behind the Controller protocol)

import dataclasses

import numpy as np
import pytest
from arm_states import REST, UNCERTAIN, P, U, hand_set, random_box, random_instant, simulated

from controllers.sliding_mode import reaching_time_bound
from octarm.arm.lagrange import (
    coriolis_matrix,
    damping_matrix,
    equilibrium,
    inverse_dynamics,
    kinetic_energy,
    mass_matrix,
    potential_force,
)
from octarm.arm.nominal import LagrangeModel
from octarm.arm.parameters import ArmParameters
from octarm.references import SetPoint, named_reference
from octarm.simulation.environment import load
from octarm.simulation.rollout import rollout

# The gain from a declared uncertainty, eq (40)


@pytest.mark.parametrize("modules", [1, 3, 5])
def test_the_bound_covers_every_arm_of_the_box_and_one_at_a_vertex_attains_it(modules: int):
    n, draw = 3000, np.random.default_rng(modules)
    arm = ArmParameters(
        mass=draw.uniform(0.1, 0.3, modules),
        inertia=draw.uniform(2e-4, 8e-4, modules),
        width=0.08,
        stiffness=draw.uniform(800.0, 1200.0, (2, modules)),
        damping=draw.uniform(5.0, 15.0, (2, modules)),
        rest_length=draw.uniform(0.08, 0.15, modules),
        gravity=9.81,
    )
    (_, q, v), (_, v_r, a_r) = random_instant(n, arm)
    bound = LagrangeModel(arm).largest_error(np.array(U), q, v, a_r, v_r)

    def error(true: ArmParameters) -> np.ndarray:
        return inverse_dynamics(arm, q, v, a_r, v_r) - inverse_dynamics(true, q, v, a_r, v_r)

    def true_arm(nominal_factors: dict[str, np.ndarray]) -> ArmParameters:
        return arm.scaled(**{name: 1.0 / factor for name, factor in nominal_factors.items()})

    F = error(true_arm(random_box(arm, draw, n)))
    assert np.all(np.abs(F) <= bound * (1.0 + 1e-9))

    # What each parameter contributes: the force is linear in it.
    def contribution(name: str, index: tuple) -> np.ndarray:
        double = np.ones(getattr(arm, name).shape)
        double[index] = 2.0
        return -error(arm.scaled(**{name: double}))

    for i in (0, modules - 1, modules, 2 * modules - 1):
        attained = np.zeros(n)
        for sign in (-1.0, 1.0):
            vertex = {}
            for name in UNCERTAIN:
                share = 0.5 * U if name == "stiffness" else U
                shape = getattr(arm, name).shape
                vertex[name] = np.empty((n, *shape))
                for index in np.ndindex(shape):
                    side = np.where(contribution(name, index)[:, i] > 0.0, sign, -sign)
                    vertex[name][:, *index] = 1.0 + share * side
            attained = np.maximum(attained, np.abs(error(true_arm(vertex))[:, i]))
        np.testing.assert_allclose(attained, bound[:, i], rtol=1e-9)


def test_the_bound_counts_backbone_and_bend_without_force():
    """The worst of all vertices, of which one parameter after another is taken off."""
    draw = np.random.default_rng(5)
    arm = dataclasses.replace(
        P, rest_angle=[0.2, -0.1, 0.3], backbone_stiffness=draw.uniform(0.1, 300.0, (2, 3)),
        backbone_damping=draw.uniform(0.1, 3.0, (2, 3)),
    )  # fmt: skip
    (_, q, v), (_, v_r, a_r) = random_instant(20, arm)
    bound = LagrangeModel(arm).largest_error(np.array(U), q, v, a_r, v_r)
    worst = np.zeros((2, *q.shape))
    total = inverse_dynamics(arm, q, v, a_r, v_r)
    for name in (*UNCERTAIN, "backbone_stiffness", "backbone_damping"):
        share = 0.5 * U if name.endswith("stiffness") else U
        for index in np.ndindex(getattr(arm, name).shape):
            less = np.array(getattr(arm, name))
            less[index] *= 0.5  # not 0, which is no mass
            part = 2.0 * (
                total - inverse_dynamics(dataclasses.replace(arm, **{name: less}), q, v, a_r, v_r)
            )
            sides = [(1.0 - 1.0 / (1.0 + share * side)) * part for side in (-1.0, 1.0)]
            worst += [np.minimum(*sides), np.maximum(*sides)]
    np.testing.assert_allclose(bound, np.abs(worst).max(axis=0), rtol=1e-9)


@pytest.mark.parametrize("mismatch", [-U, -0.1, 0.2, U])
def test_the_uncertainty_is_what_a_mismatch_does(mismatch: float):
    (_, q, v), (_, v_r, a_r) = random_instant(3000)
    nominal = P.mismatched(mismatch)
    F = inverse_dynamics(nominal, q, v, a_r, v_r) - inverse_dynamics(P, q, v, a_r, v_r)
    bound = LagrangeModel(nominal).largest_error(np.array(abs(mismatch)), q, v, a_r, v_r)
    assert np.all(np.abs(F) <= bound * (1.0 + 1e-9))


def printed_gain(nominal: ArmParameters, v: np.ndarray, q: np.ndarray, s: np.ndarray) -> np.ndarray:
    """(40) as printed, without eta: |D~ s| + |C s| + |G| + |K_v s|."""
    K_v = hand_set("smc", nominal).K_v
    D_tilde = mass_matrix(nominal, q) - mass_matrix(P, q)
    C = coriolis_matrix(P, q, v) + damping_matrix(P)
    parts = (D_tilde @ s[..., None], C @ s[..., None])
    return sum(np.abs(x[..., 0]) for x in parts) + np.abs(potential_force(P, q)) + np.abs(K_v * s)


@pytest.mark.parametrize("mismatch", [-U, U])
def test_the_gain_as_printed_is_too_small(mismatch: float):
    """(40) takes s for q_r' and q_r'', and G for its error: on the surface only |G| is left."""
    nominal = P.mismatched(mismatch)
    times = np.linspace(0.0, 2.0, 201)
    motion = named_reference("sine", REST)
    q, v, a = (np.stack(x) for x in zip(*map(motion, times), strict=True))
    F = np.abs(inverse_dynamics(nominal, q, v, a) - inverse_dynamics(P, q, v, a))
    short = F > printed_gain(nominal, v, q, np.zeros_like(q))
    assert np.all(np.any(short, axis=-1))  # of some coordinate, at every instant of the sine
    assert np.all(F <= LagrangeModel(nominal).largest_error(np.array(U), q, v, a, v) * (1.0 + 1e-9))

    measurement, reference = random_instant(3000)
    surface = hand_set("smc", P).surface(measurement, reference)
    _, q, v = measurement
    arguments = (q, v, surface.a_r, surface.v_r)
    F = np.abs(inverse_dynamics(nominal, *arguments) - inverse_dynamics(P, *arguments))
    short = F > printed_gain(nominal, v, q, surface.s)
    assert np.mean(np.any(short, axis=-1)) > 0.01
    assert np.all(F <= LagrangeModel(nominal).largest_error(np.array(U), *arguments) * (1.0 + 1e-9))


def test_a_gain_is_either_given_or_derived():
    given = hand_set("smc", P)
    assert given.uncertainty is None and given.eta is None
    derived = hand_set("smc", P, {"uncertainty": U})
    assert derived.K is None and np.all(derived.eta > 0.0)
    own = {f.name: getattr(given, f.name) for f in dataclasses.fields(given)}
    for wrong, message in (
        ({"uncertainty": U}, "both of K and uncertainty are given; the gain is either set, or"),
        ({"K": None}, "neither of K and uncertainty are given; the gain is either set, or"),
        ({"eta": 1.0}, "eta is given without uncertainty; only a derived K has that part"),
        ({"K": None, "uncertainty": 1.0}, "uncertainty holds 1; it must be at least 0, below 1"),
        ({"K": None, "uncertainty": [0.1, 0.2]}, "uncertainty has 2 values; it is one number an"),
        ({"K": None, "uncertainty": 0.1, "eta": 0.0}, "eta holds 0; it must be above 0"),
    ):
        with pytest.raises(ValueError, match=message):
            type(given)(**(own | wrong))


# The reaching time, eqs (14) and (15)


def test_the_reaching_bound_of_one_coordinate_is_the_time_that_it_takes():
    """Without damping, with the exact model and only theta off, s falls at the rate eta / I.

    The springs are soft: what they change within a period is not compensated, and would delay it.
    """
    arm = ArmParameters(
        mass=[0.2],
        inertia=[5e-4],
        width=0.08,
        stiffness=[[50.0], [50.0]],
        damping=[[0.0], [0.0]],
        rest_length=[0.1],
        gravity=9.81,
    )
    rest, eta = equilibrium(arm), np.array([10.0, 0.01])
    gains = {"uncertainty": 0.0, "eta": eta, "K_v": 0.0, "lambda": 15.0}
    off = rest + np.array([0.0, 0.2])
    controller = hand_set("smc", arm, gains)
    run = simulated(controller, SetPoint(q=rest), 0.2, arm=arm, start=off, dt=2.5e-4)
    bound, s = run[2][0]["reaching_bound"], np.array([signals["s"] for signals in run[2]])
    np.testing.assert_allclose(bound, 5e-4 * 15.0 * 0.2 / 0.01)
    measured = run[0][np.argmax(s[:, 1] <= 0.0)]
    assert abs(measured - bound[0]) < 3 * 2.5e-4


@pytest.mark.parametrize("mismatch", [-U, 0.0, U])
def test_the_surface_is_reached_within_the_bound(mismatch: float):
    """The arm starts at rest, the default sine does not: s(0) = -q_d'(0)."""
    controller = hand_set("smc", P.mismatched(mismatch), {"uncertainty": U})
    run = rollout(load(timestep=1e-4), controller, 0.2)
    V = kinetic_energy(P, run.q, run.signals["s"])
    left = V > 1e-3 * V[0]  # what remains below that is chattering
    reached = run.t[np.nonzero(left)[0][-1] + 1]
    bound = run.signals["reaching_bound"][:, 0]
    assert 0.05 < reached < bound[0]
    # At every instant on the way the time that is left falls at least as fast as time passes.
    on_the_way = V > 0.01 * V[0]
    assert np.max(np.diff(bound[on_the_way])) <= -1e-4


def test_the_reaching_bound_holds_for_every_arm_of_the_box_and_every_bend():
    """V' <= -sqrt(2 V / L) needs 2 V <= L y^2, y = sum eta |s|, whatever the arm on the way."""
    n, draw = 3000, np.random.default_rng(3)
    nominal = P.scaled(**random_box(P, draw, n))
    q, s = random_instant(n)[0].q, random_instant(n, seed=1)[0].v
    eta, u = hand_set("smc", P, {"uncertainty": U}).eta, np.array(U)
    V = kinetic_energy(nominal, q, s)[..., None]
    bound = reaching_time_bound(LagrangeModel(nominal), u, eta, q, V)[:, 0]
    bent = q.copy()
    bent[:, 3:] = draw.uniform(-3.0, 3.0, (n, 3))
    later = draw.normal(size=(n, 6)) / eta * draw.integers(0, 2, (n, 6))
    y = np.sum(eta * np.abs(later), axis=-1)
    L = 2.0 * kinetic_energy(P, bent, later) / np.maximum(y, 1e-9) ** 2
    assert np.all(np.sqrt(2.0 * kinetic_energy(P, q, s) * L) <= bound)
    # For the exact model, the straight arm and the slowest coordinate alone there is nothing left.
    straight = np.concatenate([q[:, :3], np.zeros((n, 3))], axis=-1)
    exact = reaching_time_bound(LagrangeModel(P), np.array(0.0), eta, straight, V)[:, 0]
    D_ii = np.diagonal(mass_matrix(P, straight), axis1=-2, axis2=-1)
    np.testing.assert_allclose(exact, np.sqrt(2.0 * V[:, 0] * np.max(D_ii / eta**2, axis=-1)))

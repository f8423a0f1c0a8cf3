"""Whether a sampled loop is stable, against rod theory's table and against simulation."""

import dataclasses

import numpy as np
import pytest
from scipy.linalg import expm

from controllers import CONTROLLERS, make_controller
from octarm.arm.actuation import GroundedActuation
from octarm.arm.lagrange import equilibrium
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.arm.rod import Rod, arm_from_rod
from octarm.checks.sampled_loop import (
    LinearPlant,
    Loop,
    NoSlopeError,
    first_mode,
    linear_law,
)
from octarm.interfaces import Command, Controller, Measurement, Reference
from octarm.references import SetPoint
from octarm.simulation.environment import load

P = nominal_parameters()
MODEL = arm_from_rod(Rod(), 3)

# Gains for three modules, so that other ones that are shipped later change nothing here.
LAYER = {
    "lambda": 59.7,
    "K_v": [91.24, 91.24, 91.24, 1.369, 0.4562, 0.09124],
    "K": [8.511, 5.32, 4.256, 0.2086, 0.1304, 0.01565],
    "phi": [0.03861] * 3 + [0.08773] * 3,
}
LAYER_BY_HAND = {
    "lambda": 15.0,
    "K_v": [10.0, 10.0, 10.0, 0.15, 0.05, 0.01],
    "K": [1.6, 1.0, 0.8, 0.4, 0.25, 0.03],
    "phi": [0.05] * 3 + [0.8] * 3,
}
RULES = {
    "alpha0": [-1.0, -0.5, 0.0, 0.5, 1.0], "sigma0": 2.0, "alpha_max": 0.25, "sigma_min": 1.0,
    "sigma_max": 3.0,
}  # fmt: skip
ADAPTIVE = RULES | {
    "lambda": 53.52,
    "K_v": [18.43, 18.43, 18.43, 0.2764, 0.09215, 0.01843],
    "phi": [0.4081] * 3 + [2.245] * 3,
    "scale": [0.4081] * 3 + [2.245] * 3,
    "eta1": [321.2] * 3 + [2.008] * 3,
    "eta2": [12850.0] * 3 + [80.3] * 3,
    "eta3": [0.9556] * 3 + [0.5973] * 3,
    "eta4": [0.9556] * 3 + [0.5973] * 3,
    "theta_max": [9.87, 9.87, 9.87, 0.8151, 0.3396, 0.05434],
    "E_max": [5.922, 5.922, 5.922, 0.4076, 0.2038, 0.02717],
    "dead_zone": [0.0204] * 3 + [0.1123] * 3,
}
ADAPTIVE_BY_HAND = RULES | {
    "lambda": 15.0,
    "K_v": LAYER_BY_HAND["K_v"],
    "phi": LAYER_BY_HAND["phi"],
    "scale": LAYER_BY_HAND["phi"],
    "eta1": [100.0] * 3 + [0.625] * 3,
    "eta2": [4000.0] * 3 + [25.0] * 3,
    "eta3": [2.0] * 3 + [1.25] * 3,
    "eta4": [2.0] * 3 + [1.25] * 3,
    "theta_max": [1.0, 1.0, 1.0, 0.6, 0.25, 0.04],
    "E_max": [0.6, 0.6, 0.6, 0.3, 0.15, 0.02],
    "dead_zone": [0.0025] * 3 + [0.04] * 3,
}


def group_sums(modules: int) -> np.ndarray:
    """B from so many modules to three, in the paper's layout."""
    sums = np.kron(np.eye(3), np.ones(modules // 3))
    return np.kron(np.eye(2), sums)


class Unlearnt:
    """A law whose state stays that of its beginning."""

    def __init__(self, law: Controller) -> None:
        self.law = law

    def initial_state(self, batch_shape: tuple[int, ...] = ()):
        return batch_shape

    def __call__(self, state, measurement, reference):
        return self.law(self.law.initial_state(state), measurement, reference)[0], state


@pytest.mark.parametrize(
    ("name", "gains", "longest"),
    [
        ("smc-boundary", LAYER, {3: 0.65, 9: 0.070, 15: 0.033, 30: 0.014}),
        ("smc-boundary", LAYER_BY_HAND, {3: 3.7, 9: 0.39, 15: 0.19, 30: 0.092}),
        ("afsmc", ADAPTIVE, {3: 9.3, 9: 0.66, 15: 0.33, 30: 0.19}),
        ("afsmc", ADAPTIVE_BY_HAND, {9: 3.0, 15: 2.3, 30: 2.1}),
    ],
    ids=["tuned layer", "layer set by hand", "tuned afsmc", "afsmc set by hand"],
)
@pytest.mark.parametrize("modules", [3, 9, 15, pytest.param(30, marks=pytest.mark.slow)])
def test_the_longest_periods_of_three_modules_on_a_rod_of_more(name, gains, longest, modules):
    """As another program computed them, to two digits; of afsmc with theta = E = 0."""
    if modules in longest:
        law = make_controller(name, MODEL, gains, gain_set="recommended")
        plant = LinearPlant.of(arm_from_rod(Rod(), modules), group_sums(modules))
        period = Loop(plant, Unlearnt(law)).longest_period()
        assert 1e3 * period == pytest.approx(longest[modules], rel=0.02)


def sizes(controller: Controller, arm: ArmParameters, period: float, count: int) -> np.ndarray:
    """How fast the simulated arm moves at control instants, let go a tiny way from rest."""
    rest = equilibrium(arm)
    steps = int(np.ceil(period / 2.5e-4))
    environment = load(
        SetPoint(q=rest), parameters=arm, timestep=period / steps, control_period=period
    )
    environment.reset()
    physics, actuation = environment.physics, GroundedActuation(arm.widths)
    away = 1e-9 * np.random.default_rng(0).normal(size=6)
    physics.set_motion(rest + away, np.zeros(6))
    zero, state, speeds = np.zeros(6), controller.initial_state(), []
    for k in range(count):
        q, v = physics.q(), physics.v()
        speeds.append(np.linalg.norm(v * np.repeat([1.0, 0.04], 3)))
        if speeds[-1] > 1e-4:  # where the law is no longer linear
            break
        measured = Measurement(k * period, q, v)
        command, state = controller(state, measured, Reference(rest, zero, zero))
        environment.step(actuation.inputs(q, command.force))
    return np.array(speeds)


@pytest.mark.parametrize(
    ("name", "gains"),
    [
        ("smc-boundary", LAYER),
        ("smc-boundary", LAYER_BY_HAND),
        ("afsmc", ADAPTIVE_BY_HAND),
        ("smc-integral", {}),
        ("computed-torque", {}),
    ],
)
def test_simulation_grows_just_beyond_the_longest_period_and_not_below(name, gains):
    """At the rate that is predicted, as the learning of afsmc is part of the loop."""
    controller = make_controller(name, MODEL, gains, gain_set="recommended")
    loop = Loop(LinearPlant.of(MODEL), controller)
    longest = loop.longest_period()
    below = sizes(controller, MODEL, 0.95 * longest, 3000)
    assert below[-1] < 0.1 * below.max()
    beyond = 1.05 * longest
    above = sizes(controller, MODEL, beyond, 5000)
    assert above[-1] > 1e-6
    late = np.log(above[len(above) // 2 :])
    rate = np.exp(np.polyfit(np.arange(len(late)), late, 1)[0])
    assert loop.radius(beyond) > 1.0
    assert np.log(rate) == pytest.approx(np.log(loop.radius(beyond)), rel=0.03)


@pytest.mark.parametrize("modules", [1, 3, 12])
def test_phi_and_gamma_are_those_of_the_matrix_exponential(modules: int):
    plant = LinearPlant.of(arm_from_rod(Rod(), modules))
    m, k = plant.G.shape
    for period in (1e-5, 1e-3, 0.05):
        step = expm(period * np.block([[plant.A, plant.G], [np.zeros((k, m + k))]]))
        phi, gamma = plant.sampled(period)
        np.testing.assert_allclose(phi, step[:m, :m], rtol=0, atol=1e-9 * np.abs(step).max())
        np.testing.assert_allclose(gamma, step[:m, m:], rtol=0, atol=1e-9 * np.abs(gamma).max())


def test_one_mass_under_a_damping_law_has_the_closed_form():
    """m v' = -K v held over T: v[k+1] = (1 - K T / m) v[k], stable up to T = 2 m / K."""

    class Damper:
        def initial_state(self, batch_shape=()):
            return None

        def __call__(self, state, measurement, reference):
            return Command(-8.0 * measurement.v), None

    mass = np.diag([0.3, 0.2])
    zero, one = np.zeros((2, 2)), np.eye(2)
    plant = LinearPlant(
        A=np.block([[-one, zero], [zero, zero]]),  # what is measured of q decays by itself
        G=np.concatenate([zero, np.linalg.inv(mass)]),
        M=np.eye(4),
        rest=np.array([0.1, 0.0]),
        names=["s1", "theta1"],
        inertia=np.diagonal(mass),
    )
    loop = Loop(plant, Damper())
    assert loop.longest_period() == pytest.approx(2.0 * 0.2 / 8.0, rel=1e-3)
    mode = first_mode(loop, 0.052)
    assert (mode.coordinate, mode.frequency) == ("theta1", pytest.approx(0.5 / 0.052))
    assert mode.radius == pytest.approx(8.0 * 0.052 / 0.2 - 1.0)


def test_a_state_of_the_law_is_part_of_the_loop():
    """An integral law z' = z + T y, Q = -z on a mass with a damper, by hand."""

    @dataclasses.dataclass
    class State:
        t: float
        z: np.ndarray
        idle: dict

    class Integral:
        def initial_state(self, batch_shape=()):
            return State(0.0, np.zeros((*batch_shape, 2)), {"unused": np.ones((*batch_shape, 3))})

        def __call__(self, state, measurement, reference):
            dt = measurement.t - state.t
            after = State(measurement.t, state.z + dt * 5.0 * measurement.v, state.idle)
            return Command(-state.z), after

    law = linear_law(Integral(), np.array([0.1, 0.0]), 0.02)
    assert law.S.shape == (2, 2)  # the idle ones are left out
    np.testing.assert_allclose(law.F, 0.0, atol=1e-9)
    np.testing.assert_allclose(law.S, np.eye(2), atol=1e-8)
    np.testing.assert_allclose(
        law.C @ law.R, np.hstack([np.zeros((2, 2)), -0.1 * np.eye(2)]), atol=1e-8
    )


@pytest.mark.parametrize("name", ["smc", "super-twisting"])
def test_a_law_that_switches_has_no_slope(name: str):
    with pytest.raises(NoSlopeError, match=r"no derivative by measurements at rest"):
        Loop(LinearPlant.of(P), make_controller(name, P, gain_set="recommended"))


@pytest.mark.parametrize(
    "name", [name for name in CONTROLLERS if name not in ("smc", "super-twisting")]
)
def test_every_other_law_is_stable_at_the_usual_period(name: str):
    loop = Loop(LinearPlant.of(P), make_controller(name, P))
    assert loop.radius(5e-4) < 1.0
    assert 5e-4 < loop.longest_period() < 0.2


def test_an_arm_that_does_not_stay_where_it_hangs_has_no_period_without_a_law():
    standing = dataclasses.replace(P, gravity=-120.0)

    class Nothing:
        def initial_state(self, batch_shape=()):
            return None

        def __call__(self, state, measurement, reference):
            return Command(np.zeros_like(measurement.q)), None

    assert Loop(LinearPlant.of(standing), Nothing()).longest_period() == 0.0
    assert Loop(LinearPlant.of(P), Nothing()).longest_period() == np.inf

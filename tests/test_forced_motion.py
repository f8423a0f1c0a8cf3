"""Under forces the physics converges to eqs (1)-(5) at the order that is stated."""
# pyright: reportAttributeAccessIssue=false
# (mujoco ships no type stubs)

import dataclasses
from typing import ClassVar

import mujoco
import numpy as np
import pytest

from octarm.arm import lagrange
from octarm.arm.actuation import ACTUATIONS, GroundedActuation
from octarm.arm.mjcf import build_model, nominal_parameters, paper_order
from octarm.checks import forced_motion
from octarm.checks.free_motion import reference_motion
from octarm.checks.validation import arm_with, random_arm
from octarm.disturbances.episode import Episode, Force
from octarm.references import named_reference
from octarm.simulation.environment import load

P = nominal_parameters()
CONSTANT = np.array([12.0, -4.0, 14.0, 2.0, 10.0, -3.0])  # [N]
RK4 = mujoco.mjtIntegrator.mjINT_RK4


def orders(errors: list[float]) -> list[float]:
    """Orders of convergence of errors at timesteps each of which is half the one before."""
    return np.log2(np.divide(errors[:-1], errors[1:])).tolist()


@pytest.fixture(scope="module")
def reference() -> np.ndarray:
    return forced_motion.references(P)


def test_the_constant_inputs_are_those_of_the_nominal_arm():
    tau = forced_motion.inputs(P)
    assert tau.shape == (forced_motion.SAMPLES, len(forced_motion.DRIVEN), 6)
    np.testing.assert_allclose(tau[:, 0::2], np.broadcast_to(CONSTANT, tau[:, 0::2].shape))
    assert np.ptp(tau[:, 1], axis=0).min() > 0.0


@pytest.mark.parametrize("actuation", ACTUATIONS)
def test_an_environment_under_constant_inputs_is_of_fourth_order(actuation, reference):
    """The errors at 1, 0.5 and 0.25 ms; first order would leave 1e-4."""
    right = reference[-1, forced_motion.DRIVEN.index(f"constant {actuation}")]
    errors = []
    for timestep in (1e-3, 5e-4, 2.5e-4):
        environment = load(timestep=timestep, control_period=0.025, actuation=actuation)
        observed = environment.reset().observation
        for _ in range(20):
            observed = environment.step(CONSTANT).observation
        errors.append(np.max(np.abs(observed["q"] - right)))
    assert np.all(np.array(errors) < [5e-9, 3e-10, 3e-11])
    assert orders(errors) == pytest.approx([4.0, 4.0], abs=0.1)


@pytest.mark.parametrize("modules", [1, 2, 5])
def test_the_orders_of_other_arms(modules):
    p = random_arm(np.random.default_rng(modules), modules)
    reference = forced_motion.references(p)
    for motion in forced_motion.driven(build_model(p), p, reference).values():
        assert motion.observed_order(RK4) == pytest.approx(4.0, abs=0.3)
    payload, step, pulse, sine = forced_motion.disturbed_orders(p, reference).values()
    assert payload == pytest.approx(4.0, abs=0.3)
    # One module ends on the base's axis: there no force on the tip depends on q.
    assert [step, pulse] == pytest.approx([4.0 if modules == 1 else 2.0] * 2, abs=0.3)
    assert sine == pytest.approx(1.0, abs=0.1)


def test_inputs_whose_reaction_is_not_on_the_ground_miss_the_reference(reference):
    model = build_model(P)
    model.actuator_gear[model.actuator("reaction_1_3").id, 5] *= 1.0 + 1e-4
    motions = forced_motion.driven(model, P, reference)
    errors = {name: motion.error(RK4, 1000) for name, motion in motions.items()}
    assert min(errors["constant f-coeff"], errors["sinusoidal f-coeff"]) > 1e-7
    assert max(errors["constant internal"], errors["sinusoidal internal"]) < 1e-8


def test_tendon_forces_held_over_a_step_would_be_of_first_order(reference):
    """What `validate` would see of a map from tau to column forces once a step."""
    model, errors = build_model(P), []
    grounded, internal = (ACTUATIONS[name](P.widths) for name in ("f-coeff", "internal"))
    qpos, _ = paper_order(model)
    for steps in (500, 1000):
        model.opt.timestep = forced_motion.DURATION / steps
        data = mujoco.MjData(model)
        mujoco.mj_resetDataKeyframe(model, data, 0)
        for _ in range(steps):
            q = data.qpos[qpos]
            data.ctrl[:] = internal.ctrl(internal.inputs(q, grounded.force(q, CONSTANT)))
            mujoco.mj_step(model, data)
        errors.append(np.max(np.abs(data.qpos[qpos] - reference[-1, 0])))
    assert errors[1] > 1e-4
    assert orders(errors) == pytest.approx([1.0], abs=0.1)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Spring(Force):
    """A stiff spring between the ground and the first angle."""

    name: ClassVar[str] = "spring"

    def start(self, episode: Episode):
        first = episode.coordinates // 2

        def force(step: int, q: np.ndarray) -> np.ndarray:
            out = np.zeros_like(q)
            out[..., first] = -20.0 * q[..., first]
            return out

        return force


@pytest.mark.parametrize("batch", [None, 2])
def test_a_force_of_ones_own_that_depends_on_q_is_of_second_order(batch):
    grounded, spring = GroundedActuation(P.widths), Spring()
    held = spring.start(
        Episode(
            parameters=P,
            timestep=1e-3,
            reference=named_reference("sine", lagrange.equilibrium(P)),
            seeds=np.random.SeedSequence(0),
        )
    )

    def force(sample: int, t: float, q: np.ndarray) -> np.ndarray:
        return grounded.force(q, CONSTANT) + held(0, q)

    rest = lagrange.equilibrium(P)
    right = reference_motion(P, rest, 0.0 * rest, force, np.linspace(0.0, 0.25, 11))[-1]
    errors = []
    for timestep in (1e-3, 5e-4, 2.5e-4):
        environment = load(
            disturbances=[spring], timestep=timestep, control_period=0.025, batch=batch
        )
        observed = environment.reset()
        for _ in range(10):
            observed = environment.step(np.zeros(environment.physics.q().shape) + CONSTANT)
        errors.append(np.max(np.abs(observed.observation["q"] - right)))
    assert errors[1] < 1e-5
    assert orders(errors) == pytest.approx([2.0, 2.0], abs=0.1)


def test_a_held_spring_feeds_the_arm_no_energy():
    """Half a step late, it would undo damping: the undamped arm would swing higher and higher."""
    p = arm_with(1).scaled(damping=1e-6)
    environment = load(parameters=p, disturbances=[Spring()], timestep=1e-3, control_period=0.01)
    environment.reset()
    physics = environment.physics
    physics.set_motion(physics.q() + np.array([0.0, 0.1]), np.zeros(2))
    swings = []
    for _ in range(200):
        environment.step(np.zeros(2))
        swings.append(abs(physics.q()[1]))
    assert 0.09 < max(swings) < 0.102

"""A batch of arms: every arm does what it does alone, bit for bit."""
# pyright: reportAttributeAccessIssue=false
# (mujoco ships no type stubs)

from collections.abc import Sequence

import numpy as np
import pytest
from numpy.random import SeedSequence

from controllers import CONTROLLERS, make_controller
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.disturbances.spelling import parse_disturbance
from octarm.interfaces import Command, Controller, Instant
from octarm.simulation.environment import load
from octarm.simulation.rollout import rollout, simulate

pytestmark = pytest.mark.usefixtures("each_engine")

P = nominal_parameters()
DURATION = 0.03


def states_of_batch(controller: Controller, arms: int, **options) -> tuple[np.ndarray, np.ndarray]:
    """True coordinates of every arm at every control instant, shape (T, n, 2N), and who is left."""
    environment = load(batch=arms, **options)
    rows: list[np.ndarray] = []
    simulate(environment, controller, DURATION, lambda instant: rows.append(instant.q))
    return np.stack(rows), environment.physics.intact()


def seeds(numbers: Sequence[int]) -> list[SeedSequence]:
    return [SeedSequence(number) for number in numbers]


@pytest.mark.parametrize("name", CONTROLLERS)
def test_each_arm_of_a_batch_does_what_it_does_alone(name: str):
    disturbances = [parse_disturbance(text) for text in ("noise:0.4", "payload:0.1,at=0.01")]
    numbers = [5, 3, 11]
    controller = make_controller(name, P.mismatched(-0.3))
    together, _ = states_of_batch(controller, 3, disturbances=disturbances, seed=seeds(numbers))
    for i, number in enumerate(numbers):
        alone = rollout(
            load(disturbances=disturbances, seed=SeedSequence(number)), controller, DURATION
        )
        np.testing.assert_array_equal(alone.q, together[:, i])


@pytest.mark.parametrize(("arms", "threads"), [(1, 1), (7, 1), (256, 2)])
def test_size_order_and_threads_of_a_batch_do_not_matter(arms: int, threads: int):
    numbers = np.random.default_rng(arms).permutation(arms).tolist()
    noise = parse_disturbance("noise:0.4")
    controller = make_controller("smc-boundary", P.mismatched(0.3))
    together, _ = states_of_batch(
        controller, arms, disturbances=[noise], seed=seeds(numbers), threads=threads
    )
    few = [0, arms // 2, arms - 1]
    again, _ = states_of_batch(
        controller, 3, disturbances=[noise], seed=seeds([numbers[i] for i in few])
    )
    np.testing.assert_array_equal(again, together[:, few])


def test_arms_may_have_their_own_parameters_and_nominal_models():
    factor = np.array([0.8, 1.0, 1.3])
    arms = P.scaled(mass=factor[:, None], width=factor[:, None], rest_length=factor[:, None])
    believed = arms.scaled(stiffness=np.array([0.9, 1.0, 1.1])[:, None, None])
    together, _ = states_of_batch(
        make_controller("smc-boundary", believed), 3, parameters=arms, reference="set-point"
    )
    for i in range(3):
        environment = load("set-point", parameters=arms.arm(i))
        alone = rollout(environment, make_controller("smc-boundary", believed.arm(i)), DURATION)
        np.testing.assert_array_equal(alone.q, together[:, i])


class Push:
    """Pushes arm i with its own constant force."""

    def __init__(self, force: np.ndarray) -> None:
        self.force = force

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> None:
        del batch_shape

    def __call__(self, state: None, measurement, reference) -> tuple[Command, None]:
        del reference
        return Command(np.broadcast_to(self.force, measurement.q.shape).copy(), {}), state


@pytest.mark.parametrize("bad", [80.0, 1e9, np.nan, -np.inf])
def test_an_arm_that_diverges_is_frozen_and_disturbs_nobody(bad: float):
    force = np.zeros((4, 6))
    force[:, 4] = [0.1, bad, 0.2, -0.1]
    together, intact = states_of_batch(Push(force), 4)
    np.testing.assert_array_equal(intact, [True, False, True, True])
    without, _ = states_of_batch(Push(force[[0, 2, 3]]), 3)
    np.testing.assert_array_equal(together[:, [0, 2, 3]], without)
    alone = rollout(load(), Push(force[1]), DURATION)
    assert alone.status == "diverged"
    np.testing.assert_array_equal(together[: len(alone), 1], alone.q)
    np.testing.assert_array_equal(np.diff(together[len(alone) + 1 :, 1], axis=0), 0.0)


def test_it_says_when_an_arm_diverged():
    force = np.zeros((3, 6))
    force[1, 4] = 80.0
    environment = load(batch=3)
    count: list[Instant] = []
    simulate(environment, Push(force), DURATION, count.append)
    single = load()
    alone = rollout(single, Push(force[1]), DURATION)
    diverged_at = environment.physics.diverged_at()
    assert single.physics.diverged_at() == diverged_at[1] and not single.physics.intact()
    assert f"t = {diverged_at[1]:.6g} s" in alone.message
    np.testing.assert_array_equal(np.isnan(diverged_at), [True, False, True])
    assert len(count) == 60


def test_an_episode_ends_when_nobody_is_left():
    environment = load(batch=2)
    count: list[Instant] = []
    simulate(environment, Push(np.full((2, 6), 90.0)), DURATION, count.append)
    assert 0 < len(count) < 60


def test_arrays_are_contiguous_along_the_arms():
    environment = load(batch=5)
    environment.reset()
    physics = environment.physics
    for array in (physics.q(), physics.v(), physics.hanging(), *physics.input_range()):
        assert array.shape == (5, 6)
        assert array.T.flags.c_contiguous


def test_states_are_copies_of_what_was_set_and_stepped():
    physics = load(batch=2).physics
    q = physics.hanging() + 0.001 * np.arange(12.0).reshape(2, 6)
    physics.set_motion(q, np.ones((2, 6)))
    for read, value in ((physics.q, q), (physics.v, np.ones((2, 6))), (physics.tau, 0.0 * q)):
        copy = read()
        np.testing.assert_array_equal(copy, value)
        copy[:] = 7.0
        np.testing.assert_array_equal(read(), value)
    physics.step()
    assert np.all(physics.q() != q)
    physics.reset()
    np.testing.assert_array_equal(physics.v(), 0.0)


def test_observations_and_rewards_carry_the_arms():
    environment = load(batch=5)
    environment.reset()
    step = environment.step(np.zeros((5, 6)))
    single = load()
    single.reset()
    expected = single.step(np.zeros(6))
    assert step.reward.shape == (5,)
    np.testing.assert_array_equal(step.reward, expected.reward)
    for name in ("q", "v"):
        np.testing.assert_array_equal(step.observation[name][3], expected.observation[name])
    tip = step.observation["tip_position"]
    np.testing.assert_allclose(tip[2], expected.observation["tip_position"], atol=1e-14)


def test_bad_sizes_are_refused():
    with pytest.raises(ValueError, match="batch is 0; it must be at least 1"):
        load(batch=0)
    with pytest.raises(ValueError, match="there are 2 seeds; each of 3 arms needs one"):
        load(batch=3, seed=seeds([1, 2]))
    with pytest.raises(ValueError, match="a trajectory records one arm; this environment has 2"):
        rollout(load(batch=2), Push(np.zeros(6)), 0.01)


def test_batch_parameters_need_a_batch():
    arms = ArmParameters(**{**P.to_dict(), "mass": np.tile(P.mass, (2, 1))})
    with pytest.raises(ValueError, match="batch axes"):
        load(parameters=arms)
    with pytest.raises(ValueError, match="batch axes"):
        load(parameters=arms, batch=3)

"""The tracking task: dm_env's contract, and physics that is stepped as declared."""
# pyright: reportAttributeAccessIssue=false, reportIncompatibleMethodOverride=false
# (mujoco ships no type stubs, dm_env's mixin no annotations)

import pickle
import re

import dm_env.test_utils
import mujoco
import numpy as np
import pytest
from absl.testing import absltest
from dm_control.rl import control
from dm_control.suite.wrappers import action_noise

import octarm
from octarm.arm.mjcf import build_model, nominal_parameters, paper_order
from octarm.errors import OctarmError
from octarm.simulation.environment import load, whole_periods


class EnvironmentContract(dm_env.test_utils.EnvironmentTestMixin, absltest.TestCase):
    """dm_env's own conformance tests, through an end of episode."""

    def make_object_under_test(self):
        return load(duration=0.004)


class WrappedContract(dm_env.test_utils.EnvironmentTestMixin, absltest.TestCase):
    """The same with dm_control's action noise around it."""

    def make_object_under_test(self):
        return action_noise.Wrapper(load(duration=0.004), scale=0.001)


def test_observations_share_no_memory():
    environment = load()
    first = environment.reset().observation
    kept = {name: value.copy() for name, value in first.items()}
    second = environment.step(np.ones(6)).observation
    for name, value in first.items():
        np.testing.assert_array_equal(value, kept[name])
        assert not np.shares_memory(value, second[name])
        assert not np.shares_memory(value, environment.physics.data.qpos)
        value[:] = 1e9  # and writing into one disturbs nobody
    third = environment.step(np.ones(6)).observation
    assert all(np.all(np.abs(value) < 1e3) for value in third.values())


def test_it_starts_at_rest_in_equilibrium_and_stays_there():
    environment = load("set-point", timestep=0.001)
    rest = environment.reset().observation["q"]
    moved = [environment.step(np.zeros(6)).observation for _ in range(200)][-1]
    np.testing.assert_allclose(moved["q"], rest, atol=1e-14)
    np.testing.assert_allclose(moved["v"], 0.0, atol=1e-12)


def test_the_same_seedless_actions_give_the_same_states_bit_for_bit():
    draws = np.random.default_rng(3).normal(size=(50, 6))
    runs = []
    for _ in range(2):
        environment = load()
        environment.reset()
        runs.append([environment.step(tau).observation["q"] for tau in draws])
    np.testing.assert_array_equal(*runs)


def test_reset_restores_the_start():
    environment = load()
    start = environment.reset().observation
    for _ in range(5):
        environment.step(np.full(6, 3.0))
    again = environment.reset().observation
    for name, value in start.items():
        np.testing.assert_array_equal(value, again[name])
    np.testing.assert_array_equal(environment.physics.tau(), 0.0)


def test_a_step_is_mujocos_own_step_under_f_coeff_of_the_true_coordinates():
    """Three physics steps a period, with the motors' inputs held."""
    environment = load(control_period=0.0015)
    environment.reset()
    tau = np.array([4.0, -2.0, 1.0, 3.0, -1.0, 0.5])
    observed = environment.step(tau).observation
    model = build_model()
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    qpos, qvel = paper_order(model)
    for _ in range(3):
        data.ctrl[:] = *tau, *tau[2:]
        mujoco.mj_step(model, data)
    np.testing.assert_array_equal(observed["q"], data.qpos[qpos])
    np.testing.assert_array_equal(observed["v"], data.qvel[qvel])
    assert data.time == pytest.approx(environment.physics.time())


def test_tip_position_is_that_of_the_observed_coordinates():
    from octarm.arm.lagrange import positions
    from octarm.arm.mjcf import world_position

    environment = load()
    environment.reset()
    tau = np.array([9.0, -9.0, 5.0, -5.0, 2.0, 1.0])
    seen = [environment.step(tau).observation for _ in range(20)][-1]
    tip = world_position(positions(seen["q"]))[-1]
    np.testing.assert_allclose(seen["tip_position"], tip[::2], atol=1e-14)


def test_the_episode_ends_after_whole_periods():
    environment = load(duration=0.07, timestep=0.001, control_period=0.005)
    environment.reset()
    steps = 0
    while not environment.step(np.zeros(6)).last():
        steps += 1
    assert steps + 1 == 14  # float arithmetic on the time limit would give 15
    assert environment.task.time == pytest.approx(0.07)


@pytest.mark.parametrize(
    ("duration", "period", "expected"),
    [
        (0.035, 0.005, 7),
        (0.07, 0.005, 14),
        (1.11, 0.005, 222),
        (10.0, 0.0005, 20000),
        (1e-9, 1, 1),
        (0.0101, 0.005, 3),
    ],
)
def test_durations_are_counted_in_whole_periods(duration: float, period: float, expected: int):
    assert whole_periods(duration, period) == expected


def test_rewards_lie_in_the_unit_interval_and_one_means_no_error():
    environment = load("set-point")
    environment.reset()
    rewards = [environment.step(np.full(6, 20.0)).reward for _ in range(100)]
    assert all(0.0 <= reward <= 1.0 for reward in rewards)
    perfect = load(lambda t: _rest())
    perfect.reset()
    assert perfect.step(np.zeros(6)).reward == pytest.approx(1.0)


def _rest():
    from octarm.arm.lagrange import equilibrium
    from octarm.interfaces import Reference

    rest = equilibrium(nominal_parameters())
    return Reference(rest, 0.0 * rest, 0.0 * rest)


def test_an_arm_that_leaves_its_limits_ends_the_episode_and_is_named():
    environment = load()
    environment.reset()
    tau = np.array([0.0, 0.0, 0.0, 0.0, 150.0, -150.0])
    steps = [environment.step(tau)]
    while not steps[-1].last():
        steps.append(environment.step(tau))
    assert steps[-1].discount == 0.0
    assert re.match(r"diverged at t = 0\.\d+ s: theta3 ", environment.physics.divergence())


def test_internal_actuation_pushes_neighbours_only():
    environment = load(actuation="internal")
    environment.reset()
    environment.physics.set_control(np.array([0.0, 0.0, 0.0, 0.0, 1.0, 1.0]))
    environment.physics.step()
    force = environment.physics.data.qfrc_actuator[environment.physics._qvel_index]
    np.testing.assert_allclose(force, [0.0, 0.0, 2.0, 0.0, 0.0, 0.0], atol=1e-15)


def test_bad_arguments_are_refused_in_one_sentence():
    with pytest.raises(ValueError, match=r"control period is 0.0007 s; .*whole multiple.*0.0005 s"):
        load(control_period=0.0007)
    with pytest.raises(ValueError, match="unknown actuation 'intern', did you mean 'internal'"):
        load(actuation="intern")
    with pytest.raises(ValueError, match="duration is -1 s; it must be positive"):
        load(duration=-1.0)
    with pytest.raises(ValueError, match="timestep is 0 s; it must be between"):
        load(timestep=0.0)


def test_an_arm_that_cannot_hang_in_one_piece_is_refused():
    soft = nominal_parameters().scaled(stiffness=1e-3)
    with pytest.raises(ValueError, match=r"cannot hang in one piece: at rest s1 is .* m, outside"):
        load(parameters=soft)


def test_a_long_control_period_stops_at_the_first_bad_physics_step():
    environment = load(control_period=1.0)
    environment.reset()
    ended = environment.step(np.full(6, 1e5))
    assert ended.last() and ended.discount == 0.0 and ended.reward == 0.0
    assert environment.physics.time() < 0.01
    assert environment.physics.divergence().startswith("diverged at t = 0.00")


def test_a_state_that_mujoco_refuses_is_an_error_not_a_restart():
    environment = load()
    environment.reset()
    environment.physics.data.qpos[0] = np.nan
    with pytest.raises(control.PhysicsError):
        environment.physics.step()


def test_speeds_have_limits_too():
    physics = load().physics
    rest = physics.hanging()
    assert physics.limits.hold(rest, np.zeros(6))
    for j, top in enumerate([4.8] * 3 + [50.0] * 3):
        v = np.zeros(6)
        v[j] = -1.01 * top
        assert not physics.limits.hold(rest, v)
        assert physics.limits.violation(rest, v).startswith(("s1", "s2", "s3", "theta")[min(j, 3)])
        v[j] = np.nan
        assert not physics.limits.hold(rest, v)


def test_the_reward_is_a_tenth_when_every_coordinate_is_off_by_its_margin():
    physics, task = load("set-point").physics, load("set-point").task
    with physics.reset_context():
        task.initialize_episode(physics)
        off = task._desired.q + np.array([0.01] * 3 + [0.1] * 3)
        physics.set_motion(off, np.zeros(6))
    assert task.get_reward(physics) == pytest.approx(0.1)


def test_the_seed_reaches_what_wrappers_draw_from():
    draws = [load(seed=seed).task.random.normal() for seed in (5, 5, 6)]
    assert draws[0] == draws[1] != draws[2]


def test_copies_and_pickles_go_on_alike():
    physics = load(actuation="internal").physics
    physics.set_control(np.arange(6.0))
    twins = [physics.copy(), pickle.loads(pickle.dumps(physics))]
    for one in (physics, *twins):
        one.step(20)
    for twin in twins:
        np.testing.assert_array_equal(twin.q(), physics.q())


def test_the_package_offers_its_fixed_names():
    for name in ("ArmParameters", "build_model", "load", "rollout", "Trajectory"):
        assert hasattr(octarm, name)


@pytest.mark.parametrize("batch", [None, 2])
def test_an_action_of_another_shape_is_refused(batch):
    environment = octarm.load(batch=batch)
    environment.reset()
    for action in (np.zeros(5), np.zeros((3, 6)), 0.0):
        with pytest.raises(OctarmError, match=r"the action has shape \(.*\); it must be \(.*6,?\)"):
            environment.step(action)
    with pytest.raises(OctarmError, match="the action is 'a'; it must be an array of numbers"):
        environment.step("a")

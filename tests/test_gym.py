"""Gymnasium's contract, and what its environments have to do with the loops of octarm."""

import importlib
import importlib.util
import sys
import warnings
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import octarm
import octarm.gym
from controllers import make_controller
from octarm.disturbances.spelling import parse_disturbance
from octarm.errors import OctarmError

ID = "octarm/Track-v0"
NOISY: dict[str, Any] = {
    "disturbances": ["noise:0.4", "measurement-noise:1e-3"],
    "start": "moving",
    "control_period": 0.005,
}


def make(**setting: Any) -> Any:
    return gymnasium.make(ID, **setting)


@pytest.mark.parametrize(
    "setting",
    [{}, {"controller": "pd"}, NOISY, {"engine": "lagrange", "arm": "eth", "start": "random"}],
    ids=["plain", "residual", "noisy", "another-arm"],
)
def test_gymnasiums_checks_pass_without_a_warning(setting: dict[str, Any]):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(make(duration=0.1, **setting).unwrapped)


@pytest.mark.parametrize("more", [NOISY, {"controller": "afsmc", "duration": 0.01}])
def test_rows_of_a_vector_are_single_runs_bit_for_bit(more: dict[str, Any]):
    """Through ends of both kinds, after which every arm begins anew by itself."""
    setting: dict[str, Any] = {"duration": 0.05} | more
    vector = gymnasium.make_vec(ID, num_envs=4, **setting)
    alone = SyncVectorEnv([lambda: make(**setting)] * 4)
    rows, others = vector.reset(seed=3), alone.reset(seed=3)
    draw, ended = np.random.default_rng(0), np.zeros(2, dtype=int)
    for k in range(70):
        np.testing.assert_array_equal(rows[0], others[0])
        assert rows[-1].keys() == others[-1].keys()
        for name, value in rows[-1].items():
            np.testing.assert_array_equal(value, others[-1][name])
        size = np.array([0.01, 0.3, 0.6, 1.0])[:, None] * (1.0 if k < 20 else 0.01)
        actions = (size * draw.choice([-1.0, 1.0], (4, 6))).astype(np.float32)
        rows, others = vector.step(actions), alone.step(actions)
        for mine, other in zip(rows[1:4], others[1:4], strict=True):
            np.testing.assert_array_equal(mine, other)
            assert mine.dtype == other.dtype
        ended += [rows[2].sum(), rows[3].sum()]
    assert ended[1] > 1 and (ended[0] > 3 or "controller" in more)


def test_make_vec_says_how_arms_begin_anew():
    vector = gymnasium.make_vec(ID, num_envs=2, duration=0.001)
    assert vector.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    assert vector.observation_space.shape == (2, 24) and vector.action_space.shape == (2, 6)
    vector.reset(seed=0)
    actions = np.zeros((2, 6), np.float32)
    assert not np.any(vector.step(actions)[3]) and np.all(vector.step(actions)[3])
    _, rewards, _, truncated, info = vector.step(np.ones((2, 6), np.float32))
    assert not np.any(rewards) and not np.any(truncated) and info["_seed"].all()


def test_some_arms_can_be_reset():
    vector: Any = gymnasium.make_vec(ID, num_envs=3, duration=1.0, start="random")
    vector.reset(seed=0)
    before = vector.step(np.zeros((3, 6), np.float32))[0]
    mask = np.array([False, True, False])
    after, info = vector.reset(seed=[7, 8, 9], options={"reset_mask": mask})
    np.testing.assert_array_equal(np.any(after != before, axis=1), mask)
    np.testing.assert_array_equal(info["_seed"], mask)
    np.testing.assert_array_equal(after[1], make(start="random").reset(seed=8)[0])


def test_a_seed_repeats_and_every_reset_draws_anew():
    env = make(**NOISY)
    starts = [env.reset(seed=seed)[0] for seed in (5, None, None, 5, None, 6)]
    for i, j in [(0, 3), (1, 4)]:
        np.testing.assert_array_equal(starts[i], starts[j])
    assert len({start.tobytes() for start in starts}) == 4


def test_the_seed_of_an_episode_is_that_of_load():
    env = make(**NOISY)
    env.reset(seed=1)
    _, info = env.reset()
    disturbances = [parse_disturbance(text) for text in NOISY["disturbances"]]
    environment = octarm.load(
        disturbances=disturbances, start="moving", control_period=0.005, seed=info["seed"]
    )
    action = np.linspace(-0.01, 0.01, 6, dtype=np.float32)
    environment.reset()
    seen = environment.step(200.0 * action.astype(np.float64)).observation
    row, *_ = env.step(action)
    arm = octarm.nominal_parameters()
    unit = np.concatenate([0.1 * arm.rest_length, np.ones(3)])
    rest = environment.physics.hanging()
    parts = [seen["q"] - rest, seen["v"], seen["q"] - seen["q_d"], seen["v"] - seen["v_d"]]
    expected = np.concatenate([part / unit for part in parts])
    np.testing.assert_allclose(row, expected, rtol=1e-6, atol=1e-7)


def test_an_action_is_a_share_of_the_input_range():
    pushing = octarm.nominal_parameters().to_dict() | {"input_range": [0.0, 30.0]}
    env = make(arm=octarm.ArmParameters(**pushing)).unwrapped
    env.reset(seed=0)
    physics = env._arms._environment.physics
    for share, force in [(-1.0, 0.0), (0.0, 15.0), (0.5, 22.5), (1.0, 30.0), (5.0, 30.0)]:
        env.reset()
        env.step(np.full(6, share))
        np.testing.assert_allclose(physics.tau(), force)


@pytest.mark.parametrize("name", ["pd", "afsmc"])
def test_a_residual_of_nothing_is_the_controller_itself(name: str):
    disturbances = [parse_disturbance("noise:0.4")]
    env = make(controller=name, mismatch=-0.3, disturbances=disturbances, duration=0.05)
    _, info = env.reset(seed=0)
    environment = octarm.load(disturbances=disturbances, seed=info["seed"])
    law = make_controller(name, octarm.nominal_parameters().mismatched(-0.3))
    run = octarm.rollout(environment, law, 0.05)
    physics = env.unwrapped._arms._environment.physics
    for k in range(99):
        env.step(np.zeros(6, np.float32))
        np.testing.assert_array_equal(physics.q(), run.q[k + 1])


def test_a_residual_is_added_as_its_share():
    taus = []
    for action in (0.0, 1.0):
        env = make(controller="pd", residual=0.05)
        env.reset(seed=0)
        env.step(np.full(6, action, np.float32))
        taus.append(env.unwrapped._arms._environment.physics.tau())
    np.testing.assert_allclose(taus[1] - taus[0], 0.05 * 200.0)


@pytest.mark.parametrize("engine", ["mujoco", "lagrange"])
def test_divergence_terminates_and_time_truncates(engine: str):
    env = make(duration=0.1, engine=engine)
    env.reset(seed=0)
    steps = [env.step(np.zeros(6, np.float32)) for _ in range(200)]
    assert [step[2] for step in steps] == [False] * 200
    assert [step[3] for step in steps] == [False] * 199 + [True]
    with pytest.raises(OctarmError, match="the episode is over; reset begins the next one"):
        env.step(np.zeros(6, np.float32))
    env.reset()
    while not (last := env.step(np.array([0, 0, 0, 0, 1, -1], np.float32)))[2]:
        assert not last[3]
    assert last[1] == 0.0 and not last[3] and last[0] in env.observation_space


def test_observations_are_bounded_whatever_is_read():
    env = make(disturbances="measurement-noise:10000%", control_period=0.005)
    rows = [env.reset(seed=0)[0], *(env.step(np.zeros(6, np.float32))[0] for _ in range(5))]
    assert all(row in env.observation_space for row in rows)
    assert np.isfinite([env.observation_space.low, env.observation_space.high]).all()


def test_what_cannot_be_is_said_in_a_sentence():
    unlimited = octarm.nominal_parameters().to_dict()
    unlimited["input_range"] = [-np.inf, np.inf]
    for setting, words in [
        ({"arm": octarm.ArmParameters(**unlimited)}, "this arm has none; give it an input_range"),
        ({"residual": 0.0, "controller": "pd"}, "residual is 0; it must be above 0 and at most 1"),
        ({"controller": "pid"}, "unknown controller 'pid', did you mean 'pd'"),
        ({"disturbances": "nois:0.4"}, "unknown disturbance 'nois', did you mean 'noise'"),
        ({"arm": "ethz"}, "unknown arm 'ethz', did you mean 'eth'"),
        ({"batch": 3}, "batch is no argument of the environment; gymnasium.make_vec has num_envs"),
        ({"start": "rando"}, "unknown start 'rando', did you mean 'random'"),
    ]:
        with pytest.raises(OctarmError, match=words):
            make(**setting)


def test_without_gymnasium_a_sentence_says_what_to_install(monkeypatch):
    present = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: None if name == "gymnasium" else present(name)
    )
    monkeypatch.delitem(sys.modules, "octarm.gym")
    for error in (OctarmError, ImportError):
        with pytest.raises(error, match=r"gymnasium: pip install 'octarm\[gym\]'"):
            importlib.import_module("octarm.gym")

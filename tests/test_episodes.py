"""Every reset draws anew what is random, and each episode can be had again."""

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from dm_control.rl import control
from numpy.random import SeedSequence
from test_disturbances import SPELLINGS

from controllers import make_controller
from octarm.arm.mjcf import nominal_parameters
from octarm.disturbances.spelling import parse_disturbance
from octarm.disturbances.streams import episode_seed, stream
from octarm.errors import OctarmError
from octarm.simulation.environment import load
from octarm.simulation.rollout import rollout, simulate
from octarm.simulation.trajectory import Trajectory

P = nominal_parameters()
PD = make_controller("pd", P)
ALL = [parse_disturbance(text) for text in SPELLINGS.values()]


def noise(environment: control.Environment) -> np.ndarray:
    """What the disturbances add over 20 physics steps, shape (20, ..., 2N)."""
    added = []
    for _ in range(20):
        environment.step(np.zeros(environment.action_spec().shape))
        added.append(environment.physics.disturbance())
    return np.stack(added)


def plant(environment: control.Environment) -> dict[str, Any]:
    return environment.physics.plant().parameters.to_dict()


DRAWN: dict[str, Callable[[control.Environment], Any]] = {
    "noise:0.4": noise,
    "measurement-noise:0.001": lambda e: e.step(np.zeros(6)).observation["q"],
    "random-mismatch:0.3": plant,
}


@pytest.mark.parametrize("text", DRAWN)
def test_resets_draw_anew_and_what_was_drawn_can_be_had_again(text: str):
    def episodes(environment: control.Environment, *numbers: int) -> list[Any]:
        found = []
        for number in numbers:
            environment.task.next_episode = number
            environment.reset()
            assert environment.task.episode == environment.physics.active.episode.index == number
            found.append(DRAWN[text](environment))
        return found

    environment = load(disturbances=[parse_disturbance(text)], seed=3)
    found = []
    for number in range(4):
        environment.reset()
        assert environment.task.episode == number
        found.append(DRAWN[text](environment))
    for i in range(4):
        for j in range(i):
            assert str(found[i]) != str(found[j])
    for other in (environment, load(disturbances=[parse_disturbance(text)], seed=3)):
        for number, again in zip((2, 0, 3), episodes(other, 2, 0, 3), strict=True):
            assert str(again) == str(found[number])
    fresh = load(disturbances=[parse_disturbance(text)], seed=4)
    assert str(episodes(fresh, 2)[0]) != str(found[2])


def test_an_episode_that_ends_is_followed_by_the_next_one():
    environment = load(disturbances=[parse_disturbance("noise:0.4")], duration=0.001)
    environment.reset()
    numbers = [environment.task.episode for _ in range(6) if environment.step(np.zeros(6))]
    assert numbers == [0, 0, 1, 1, 1, 2]


def test_runs_on_one_environment_say_which_episode_they_were(tmp_path):
    environment = load(disturbances=ALL, seed=5)
    runs = [rollout(environment, PD, 0.01) for _ in range(3)]
    assert [run.episode for run in runs] == [0, 1, 2]
    assert len({run.digest for run in runs}) == 3
    assert runs[0].digest == rollout(load(disturbances=ALL, seed=5), PD, 0.01).digest
    fresh = load(disturbances=ALL, seed=5)
    fresh.task.next_episode = runs[2].episode
    again = rollout(fresh, PD, 0.01)
    assert again.digest == runs[2].digest and again.episode == 2
    runs[2].save(tmp_path / "run.npz")
    assert Trajectory.load(tmp_path / "run.npz").episode is None


def test_an_arm_of_a_batch_has_episodes_that_depend_on_its_seed_alone():
    def rows(which: list[int], first: int) -> list[np.ndarray]:
        environment = load(
            disturbances=ALL, batch=len(which), seed=[SeedSequence(i) for i in which]
        )
        environment.task.next_episode = first
        out: list[list[np.ndarray]] = [[], []]
        for found in out:
            simulate(environment, PD, 0.01, lambda instant, found=found: found.append(instant.q))
        return [np.stack(found) for found in out]

    together = rows([4, 8, 6], 3)
    for i, row in enumerate(rows([6, 4], 3)):
        np.testing.assert_array_equal(row, together[i][:, [2, 0]])
    alone = load(disturbances=ALL, seed=8)
    alone.task.next_episode = 4
    np.testing.assert_array_equal(rollout(alone, PD, 0.01).q, together[1][:, 1])
    assert not np.any(together[0][-1] == together[1][-1])


def test_no_two_arms_and_episodes_have_a_stream_in_common():
    """Nor has an arm alone one with an arm of a batch, whose seeds have keys, or with a child."""
    root = SeedSequence(7)
    arms = [root, *(SeedSequence(7, spawn_key=(i,)) for i in range(12))]
    arms += [SeedSequence(7, spawn_key=(i, j)) for i in range(4) for j in range(4)]
    first = {
        stream(episode_seed(arm, k), name).integers(2**63)
        for arm in arms
        for k in (*range(12), 2**32, 2**40)
        for name in ("noise", "wrappers", "episode")
    }
    assert len(first) == len(arms) * 14 * 3
    assert episode_seed(root, 0) is root
    wide = SeedSequence(7, pool_size=8)
    assert episode_seed(wide, 3).pool_size == 8


def test_a_reset_that_fails_does_not_count():
    environment = load(disturbances=[parse_disturbance("payload:1e300kg")])
    for _ in range(2):
        with pytest.raises(OctarmError, match="has a module with mass"):
            environment.reset()
    assert environment.task.next_episode == 0


@pytest.mark.parametrize("number", [-1, 1.0, "2", None])
def test_a_number_that_no_episode_has_is_refused(number: Any):
    environment = load()
    environment.task.next_episode = number
    with pytest.raises(OctarmError, match=r"next_episode is .*; it must be a whole number"):
        environment.reset()
    environment.task.next_episode = np.int64(3)
    environment.reset()
    assert environment.task.episode == 3


def test_what_does_not_depend_on_the_draws_is_not_computed_again():
    environment = load(disturbances=[parse_disturbance("noise:0.4")])
    environment.reset()
    amplitude = environment.physics.active.episode.input_amplitude
    environment.reset()
    assert environment.physics.active.episode.input_amplitude is amplitude
    assert copy.copy(environment.task).episode == 1

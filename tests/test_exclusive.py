"""An environment has one user at a time; a second one is refused, and disturbs nobody."""

import pickle
import threading
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from dm_control.rl import control

from controllers import make_controller
from octarm.arm.mjcf import nominal_parameters
from octarm.disturbances.spelling import parse_disturbance
from octarm.errors import OctarmError
from octarm.simulation.environment import load
from octarm.simulation.rollout import rollout, simulate

PD = make_controller("pd", nominal_parameters())
NOISE = [parse_disturbance("noise:0.4")]
IN_USE = "in use by another thread or loop"

# What a second user may try, and what it does to an environment that it has alone.
TRIES: dict[str, Callable[[control.Environment], Any]] = {
    "a run": lambda e: simulate(e, PD, 0.001),
    "reset": lambda e: e.reset(),
    "step": lambda e: e.step(np.zeros(e.action_spec().shape)),
    "step of the physics": lambda e: e.physics.step(),
    "reset of the physics": lambda e: e.physics.reset(),
    "input": lambda e: e.physics.set_control(np.zeros(e.action_spec().shape)),
}


def in_a_thread(work: Callable[[], Any]) -> list[Exception]:
    """What another thread that does this work raises."""
    raised: list[Exception] = []

    def run() -> None:
        try:
            work()
        except OctarmError as error:
            raised.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    thread.join()
    return raised


@pytest.mark.parametrize("batch", [None, 2])
@pytest.mark.parametrize("name", TRIES)
def test_nothing_else_moves_the_arm_during_a_run(name: str, batch: int | None):
    """Neither an observer, nor the observer's thread, nor a controller."""
    environment, alone = (load(disturbances=NOISE, batch=batch) for _ in range(2))
    seen: list[np.ndarray] = []
    expected: list[np.ndarray] = []

    def observe(instant: Any) -> None:
        seen.append(instant.q)
        with pytest.raises(OctarmError, match=IN_USE):
            TRIES[name](environment)
        assert IN_USE in str(in_a_thread(lambda: TRIES[name](environment))[0])

    simulate(environment, PD, 0.005, observe)
    simulate(alone, PD, 0.005, lambda instant: expected.append(instant.q))
    np.testing.assert_array_equal(seen, expected)
    TRIES[name](environment)  # afterwards it may


def test_of_two_threads_that_run_one_environment_one_goes_on_undisturbed():
    environment, results = load(disturbances=NOISE), list[Any]()
    barrier = threading.Barrier(2)

    def work() -> None:
        barrier.wait()
        try:
            results.append(rollout(environment, PD, 0.2).digest)
        except OctarmError as error:
            results.append(error)

    threads = [threading.Thread(target=work) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    errors = [x for x in results if isinstance(x, OctarmError)]
    assert len(errors) == 1 and IN_USE in str(errors[0])
    digest = next(x for x in results if isinstance(x, str))
    assert digest == rollout(load(disturbances=NOISE), PD, 0.2).digest


def test_threads_that_meet_in_single_steps_are_both_told_until_a_reset():
    environment = load()
    environment.reset()
    met: list[Exception] = []

    def watch(physics: Any) -> None:  # while the physics is stepped
        del physics
        met.extend(in_a_thread(lambda: environment.step(np.zeros(6))))

    environment.physics.watch = watch
    environment.step(np.zeros(6))
    environment.physics.watch = None
    assert IN_USE in str(met[0])
    with pytest.raises(OctarmError, match=IN_USE):
        environment.step(np.zeros(6))
    environment.reset()
    environment.step(np.zeros(6))


def test_an_environment_may_pass_from_thread_to_thread():
    environment, other = load(disturbances=NOISE), load(disturbances=NOISE)
    environment.reset()
    other.reset()
    for _ in range(5):
        assert not in_a_thread(lambda: environment.step(np.ones(6)))
        other.step(np.ones(6))
    np.testing.assert_array_equal(environment.physics.q(), other.physics.q())
    assert not in_a_thread(lambda: rollout(environment, PD, 0.01))


def test_a_run_that_is_broken_off_leaves_the_environment_free():
    environment = load()

    def stop(instant: Any) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        simulate(environment, PD, 0.1, stop)
    assert rollout(environment, PD, 0.01).status == "ok"


@pytest.mark.parametrize("duplicate", [lambda p: p.copy(), lambda p: pickle.loads(pickle.dumps(p))])
def test_copies_are_free_while_the_original_is_in_use(duplicate: Callable[[Any], Any]):
    """An observer may look ahead on a copy."""
    environment, ahead = load(), list[np.ndarray]()

    def observe(instant: Any) -> None:
        copy = duplicate(environment.physics)
        copy.step(1)
        ahead.append(copy.q())

    simulate(environment, PD, 0.002, observe)
    digest = rollout(load(), PD, 0.002).digest
    assert rollout(environment, PD, 0.002).digest == digest
    assert len(ahead) == 4


def test_within_a_reset_the_same_thread_may_settle_the_arm():
    physics = load().physics
    with physics.reset_context():
        physics.set_control(np.zeros(6))
        physics.step(3)
    assert physics.steps() == 3

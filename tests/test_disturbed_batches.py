"""Arms of a batch under disturbances: each of them is what it is alone, bit for bit.

Also arms that do not survive, and values that make no sense.
"""

import dataclasses
import re
from collections.abc import Callable, Sequence

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from numpy.random import SeedSequence
from test_disturbances import SPELLINGS, built, descriptions
from test_disturbed_runs import ALL, DT, Listener, P

from controllers import make_controller
from octarm.checks.validation import arm_with
from octarm.disturbances.episode import Disturbance
from octarm.disturbances.spelling import DISTURBANCES, parse_disturbance
from octarm.interfaces import Controller, Instant, Measurement, Reference
from octarm.metrics.table import Metrics
from octarm.simulation.environment import load
from octarm.simulation.physics import BatchPhysics
from octarm.simulation.rollout import rollout, simulate
from octarm.simulation.steps import StepError

pytestmark = pytest.mark.usefixtures("each_engine")

CONTROLLER = make_controller("smc-boundary", P.mismatched(-0.3))
SEEDS = [SeedSequence(9, spawn_key=(i,)) for i in range(3)]


def suitable(listed, arm: int | None) -> bool:
    """Whether the physics step suits the arms that these disturbances make."""
    try:
        load(disturbances=built(listed, arm), batch=3 if arm is None else None)
    except StepError:
        return False
    return True


def instants(environment, controller: Controller, duration: float) -> tuple[list, str]:
    rows: list[Instant] = []
    message = simulate(environment, controller, duration, rows.append)
    return rows, message


def arrays(instant: Instant) -> dict[str, np.ndarray]:
    return {
        "q": instant.q,
        "v": instant.v,
        "measured q": instant.measurement.q,
        "measured v": instant.measurement.v,
        "tau": instant.tau,
        "disturbance": instant.disturbance,
    }


def assert_arms_are_rows(
    batch: Callable[[], list[Disturbance]],
    arm: Callable[[int], list[Disturbance]],
    controller: Controller = CONTROLLER,
    duration: float = 0.015,
    **options,
) -> BatchPhysics:
    """Every arm of a batch of three does what it does alone, up to its end."""
    environment = load(disturbances=batch(), batch=3, seed=SEEDS, **options)
    rows, _ = instants(environment, controller, duration)
    physics = environment.physics
    for i, ended in enumerate(physics.diverged_at()):
        single = load(disturbances=arm(i), seed=SEEDS[i], **options)
        own, message = instants(single, controller, duration)
        assert bool(message) == (not physics.intact()[i]) == (not np.isnan(ended))
        if message:
            assert single.physics.time() == pytest.approx(ended, abs=1e-9)
        for mine, its in zip(own, rows, strict=False):
            for name, value in arrays(mine).items():
                np.testing.assert_array_equal(value, arrays(its)[name][i], err_msg=name)
        for its in rows[len(own) + 1 :]:  # frozen
            np.testing.assert_array_equal(its.q[i], rows[len(own)].q[i])
    return physics


@settings(max_examples=10, deadline=None)
@given(listed=descriptions(arms=3), period=st.sampled_from([1, 3, 5]))
def test_any_combination_gives_an_arm_what_its_row_of_a_batch_gets(listed, period: int):
    assume(suitable(listed, None))
    assert_arms_are_rows(
        lambda: built(listed, None), lambda i: built(listed, i), control_period=period * DT
    )


@settings(max_examples=10, deadline=None)
@given(listed=descriptions(arms=1), name=st.sampled_from(["pd", "smc", "afsmc"]))
def test_any_combination_is_finite_or_marked_and_repeats_itself(listed, name: str):
    assume(suitable(listed, 0))
    controller = make_controller(name, P)
    environment = load(disturbances=built(listed, 0), seed=2)
    first = rollout(environment, controller, 0.01)
    environment.task.next_episode = 0
    again = rollout(environment, controller, 0.01)
    assert first.digest == again.digest
    assert first.status in ("ok", "diverged") and bool(first.message) == (first.status != "ok")
    for array_name, array in first.arrays():
        end = None if first.status == "ok" else -1  # the force that ended it may be anything
        assert np.all(np.isfinite(array[:end])), array_name
        np.testing.assert_array_equal(array, dict(again.arrays())[array_name])


@settings(max_examples=10, deadline=None)
@given(listed=descriptions(arms=1), removed=st.integers(0, 5))
def test_removing_one_disturbance_changes_no_other_force(listed, removed: int):
    def shares(which) -> list[dict[str, np.ndarray]]:
        environment = load(disturbances=built(which, 0), seed=4)
        out: list[dict[str, np.ndarray]] = []
        environment.physics.watch = lambda physics: out.append(dict(physics.active.shares))
        rollout(environment, Listener(lambda m, r: np.zeros_like(m.q)), 0.01)
        return out

    assume(suitable(listed, 0))
    on_joints = [(n, v) for n, v in listed if not str(v.get("on", "")).startswith("tip")]
    fewer = [pair for i, pair in enumerate(on_joints) if i != removed % max(1, len(on_joints))]
    for some, all_of_them in zip(shares(fewer), shares(on_joints), strict=False):
        for name, share in some.items():
            np.testing.assert_array_equal(share, all_of_them[name])


@pytest.mark.parametrize("modules", [1, 2, 5])
def test_arms_of_any_length_can_be_disturbed(modules: int):
    p = arm_with(modules)
    texts = [
        text
        for name, text in SPELLINGS.items()
        if name not in ("step", "saturation", "loss")  # which name coordinates
    ]
    listed = [parse_disturbance(text) for text in [*texts, "step:0.1,on=tip-x", "loss:0.1"]]
    controller = make_controller("smc-boundary", p)
    assert_arms_are_rows(lambda: listed, lambda i: listed, controller, duration=0.04, parameters=p)


@pytest.mark.parametrize(("dt", "period"), [(3e-4, 10), (1e-3, 5), (7e-4, 1)])
def test_periods_need_not_fit(dt: float, period: int):
    texts = ["noise:0.4,time=0.0011", "payload:0.2,at=0.0071", "measurement-delay:0.0044"]
    listed = [parse_disturbance(text) for text in [*texts, "measurement-noise:1e-3,time=0.0017"]]
    assert_arms_are_rows(lambda: listed, lambda i: listed, timestep=dt, control_period=period * dt)


def test_a_control_period_that_does_not_fit_the_timestep_is_refused():
    with pytest.raises(ValueError, match=r"control period is 0.005 s; .* multiple .* 0.0003 s"):
        load(timestep=3e-4, control_period=5e-3)


# Absurd values, and arms that do not survive

ABSURD = [
    "step:1e300N", "step:1e8N,on=tip-y", "sine:1e9N,on=tip-y", "noise:1e302%", "noise:rms=1e9N",
    "payload:1e4kg", "payload:1e300kg,at=0.005", "mismatch:-0.99", "mismatch:1e8%",
    "mismatch:0,rest_length=1e6", "measurement-noise:1e302%", "quantisation:1e302%", "slew:1e-300",
    "drift:-1e300/s,limit=0.9,of=inertia", "lag:1e300s", "actuation-delay:10",
    "pulse:1,at=1e308s,length=1e308s", "payload:1,at=1e300s", "measurement-delay:10", "tilt:3.1",
]  # fmt: skip


@pytest.mark.parametrize("text", ABSURD)
def test_absurd_values_end_a_run_or_do_nothing_and_both_alike_in_a_batch(text: str):
    listed = [parse_disturbance(text)]
    assert_arms_are_rows(lambda: listed, lambda i: listed, duration=0.012)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("payload:1e300kg", r"has a module with mass 1e\+300 kg; it must be between 1e-14 and"),
        ("mismatch:0,inertia=1e-20", r"with inertia 6e-24 kg m\^2; it must be between"),
    ],
)
def test_an_arm_that_cannot_be_simulated_is_refused(text: str, sentence: str):
    for batch in (None, 2):
        environment = load(disturbances=[parse_disturbance(text)], batch=batch)
        with pytest.raises(ValueError, match=sentence):
            environment.reset()


@pytest.mark.parametrize("period", [1, 10])
def test_an_arm_that_diverges_changes_no_other(period: int):
    """Alone it is the same too, and its metrics are not numbers."""
    push = [{"amplitude": x, "at": 0.0031, "on": "theta2"} for x in (0.1, 80.0, -0.2)]
    rest = [d for d in ALL if d.name not in ("step", "saturation", "slew", "loss")]
    step = DISTURBANCES["step"]

    def batch(which: Sequence[int]) -> list[Disturbance]:
        amplitudes = np.array([push[i]["amplitude"] for i in which])
        return [*rest, step(**{**push[0], "amplitude": amplitudes})]

    physics = assert_arms_are_rows(
        lambda: batch([0, 1, 2]),
        lambda i: [*rest, step(**push[i])],
        duration=0.03,
        control_period=period * DT,
    )
    np.testing.assert_array_equal(physics.intact(), [True, False, True])
    both = load(
        disturbances=batch([0, 2]), batch=2, seed=[SEEDS[0], SEEDS[2]], control_period=period * DT
    )
    three = load(disturbances=batch([0, 1, 2]), batch=3, seed=SEEDS, control_period=period * DT)
    kept, _ = instants(both, CONTROLLER, 0.03)
    rows, _ = instants(three, CONTROLLER, 0.03)
    for mine, its in zip(kept, rows, strict=True):
        for name, value in arrays(mine).items():
            np.testing.assert_array_equal(value, arrays(its)[name][[0, 2]], err_msg=name)
    metrics = Metrics(control_period=period * DT)
    for row in rows:
        s = row.command.signals["s"]
        q, q_d, tau, force = row.q, row.reference.q, row.tau, row.command.force
        q_d = np.broadcast_to(q_d, q.shape)
        fields = {
            "t": np.array(row.measurement.t),
            "q": q,
            "q_d": q_d,
            "tau": tau,
            "force": force,
            "s": s,
        }
        metrics.update({name: array[None] for name, array in fields.items()})
    result = metrics.result(diverged=~three.physics.intact())
    for name, value in result.items():
        assert np.all(np.isnan(value[1])), name
    assert np.all(np.isfinite(result["effort"][[0, 2]]))


def test_forces_beyond_what_mujoco_takes_end_a_run_alike_in_a_batch(each_engine: str):
    """MuJoCo drops inputs above 1e10 N, with a warning and the arm unmoved."""
    thin = dataclasses.replace(P, width=P.width * 1e-3, input_range=(-np.inf, np.inf))
    huge = "BADCTRL" if each_engine == "mujoco" else "outside"
    for force, reason in ((5e3, "moves"), (9e7, huge), (2e8, "2e.08"), (np.nan, "nan")):
        push = Listener(lambda m, r, x=force: np.full_like(m.q, [0, 0, 0, x, 0, 0]))
        alone = rollout(load(parameters=thin), push, 0.005)
        assert alone.status == "diverged" and re.search(reason, alone.message), alone.message
        environment = load(parameters=thin, batch=2)
        simulate(environment, push, 0.005, lambda instant: None)
        np.testing.assert_array_equal(environment.physics.intact(), False)
        ended = environment.physics.diverged_at()
        assert all(f"t = {at:.6g} s" in alone.message for at in ended)


def test_nothing_acts_after_a_force_that_cannot_be_applied():
    def law(measurement: Measurement, reference: Reference) -> np.ndarray:
        del reference
        return np.full_like(measurement.q, np.nan if measurement.t >= 0.00295 else 0.1)

    listed = [parse_disturbance(text) for text in ("noise:0.4", "step:1,on=all")]
    alone = rollout(load(disturbances=listed), Listener(law), 0.01)
    assert len(alone) == 7 and alone.message.endswith(
        "t = 0.003 s: the controller's force on s1 is nan"
    )
    assert np.all(alone.disturbance[:-1] != 0.0)
    np.testing.assert_array_equal(alone.disturbance[-1], 0.0)
    assert_arms_are_rows(lambda: listed, lambda i: listed, Listener(law), duration=0.01)

"""What dm_control's own suite asks of a task: names, specs, random starts, episodes that end."""

from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from arm_states import P
from dm_control.rl import control

import octarm
from octarm.arm.groups import Groups
from octarm.arm.lagrange import equilibrium
from octarm.arm.reach import hold
from octarm.commands.cli import main
from octarm.disturbances.spelling import parse_disturbance
from octarm.errors import OctarmError
from octarm.interfaces import Command
from octarm.recordings.comparison import differences
from octarm.recordings.words import title_of
from octarm.references import REFERENCES
from octarm.simulation.start import Start
from octarm.sweeps.spec_file import parse_spec

NAMES = [name for name in REFERENCES if name != "file"]  # which needs a file


def played(environment: control.Environment, steps: int, episodes: int = 2) -> list[Any]:
    """Time steps under random forces that an arm bears."""
    draw, low = np.random.default_rng(0), environment.action_spec().minimum
    out = []
    for _ in range(episodes):
        out.append(environment.reset())
        for _ in range(steps):
            out.append(environment.step(draw.uniform(-5.0, 5.0, low.shape)))
            if out[-1].last():
                break
    return out


def test_all_parts_of_the_model_have_names_and_it_has_two_cameras():
    model = octarm.load().physics.model.ptr
    kinds = "BODY JOINT GEOM SITE CAMERA LIGHT TENDON ACTUATOR SENSOR".split()
    sizes = "nbody njnt ngeom nsite ncam nlight ntendon nu nsensor".split()
    for kind, size in zip(kinds, sizes, strict=True):
        of = getattr(mujoco.mjtObj, f"mjOBJ_{kind}")
        assert all(mujoco.mj_id2name(model, of, i) for i in range(getattr(model, size)))
    assert model.ncam >= 2


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("batch", [None, 3])
@pytest.mark.parametrize("reference", NAMES)
def test_time_steps_are_as_specified(reference: str, batch: int | None, flat: bool):
    environment = octarm.load(reference, batch=batch, flat_observation=flat, duration=0.005)
    spec = environment.observation_spec()
    for step in played(environment, 20):
        assert step.observation.keys() == spec.keys()
        for name, value in step.observation.items():
            spec[name].validate(value)
            assert np.all(np.isfinite(value))
        if step.first():
            assert step.reward is None and step.discount is None
        else:
            assert np.all((step.reward >= 0.0) & (step.reward <= 1.0)) and 0 <= step.discount <= 1


@pytest.mark.parametrize("batch", [None, 3])
def test_a_flat_observation_is_all_of_them_in_order(batch: int | None):
    apart, flat = (octarm.load(batch=batch, flat_observation=x) for x in (False, True))
    shape = () if batch is None else (batch,)
    for one, other in zip(played(apart, 5), played(flat, 5), strict=True):
        assert list(other.observation) == [control.FLAT_OBSERVATION_KEY]
        row = other.observation[control.FLAT_OBSERVATION_KEY]
        rows = [np.broadcast_to(x, (*shape, x.shape[-1])) for x in one.observation.values()]
        np.testing.assert_array_equal(row, np.concatenate(rows, axis=-1))
        assert row.shape == (*shape, 32)


def test_a_loop_refuses_flat_observations():
    with pytest.raises(OctarmError, match="flat observations; a loop needs them one by one"):
        octarm.rollout(octarm.load(flat_observation=True), Nothing(), 0.1)


@pytest.mark.parametrize("reference", NAMES)
def test_no_observation_of_the_arm_is_constant(reference: str):
    """What is wanted may be constant: no reference moves all coordinates."""
    steps = played(octarm.load(reference), 50)
    for name in ("q", "v", "tip_position"):
        rows = np.array([step.observation[name] for step in steps])
        assert np.all(np.any(rows != rows[0], axis=0))


def test_the_same_seed_and_actions_give_the_same_time_steps():
    runs = [played(octarm.load(seed=4, start="moving"), 20) for _ in range(2)]
    for one, other in zip(*runs, strict=True):
        assert one.step_type == other.step_type and one.reward == other.reward
        for name, value in one.observation.items():
            np.testing.assert_array_equal(value, other.observation[name])


@pytest.mark.parametrize("start", ["random", "moving"])
@pytest.mark.parametrize("engine", ["mujoco", "lagrange"])
def test_starts_are_drawn_anew_within_their_share(start: str, engine: str):
    environment = octarm.load(start=start, start_share=0.2, engine=engine)
    limits = Start.of(P, start, 0.2)
    assert limits is not None
    rest = environment.physics.hanging()
    seen = [environment.reset().observation for _ in range(60)]
    q = np.array([row["q"] for row in seen]) - rest
    v = np.array([row["v"] for row in seen])
    slack = 1e-12
    assert np.all((q >= limits.low - slack) & (q <= limits.high + slack))
    assert np.all(np.abs(v) <= limits.speed + slack)
    assert np.all(q.max(axis=0) > 0.8 * limits.high) and np.all(q.min(axis=0) < 0.8 * limits.low)
    assert np.all(np.ptp(v, axis=0) > 0.0) if start == "moving" else not np.any(v)


@pytest.mark.parametrize("name", ["octarm", "eth", "i-support", "fabric"])
def test_what_is_drawn_can_be_held_by_the_inputs(name: str):
    """Half of what modules reach alone, whatever the others do."""
    arm = octarm.read_arm(name)
    limits = Start.of(arm, "random", 0.5)
    assert limits is not None
    low, high = limits.low[arm.modules :], limits.high[arm.modules :]
    bends = low + np.random.default_rng(0).random((300, arm.modules)) * (high - low)
    assert np.all(hold(arm, equilibrium(arm)[arm.modules :] + bends)[0])


def test_a_share_scales_the_range_and_speeds_are_those_of_a_swing():
    small, large = (Start.of(P, "moving", share) for share in (0.1, 0.2))
    assert small is not None and large is not None
    for name in ("low", "high", "speed"):
        np.testing.assert_allclose(2.0 * getattr(small, name), getattr(large, name))
    ratio = small.speed / (0.5 * (small.high - small.low))
    np.testing.assert_allclose(ratio, ratio[0])


def test_an_arm_of_a_batch_starts_as_it_does_alone():
    batch = octarm.load(batch=3, start="moving", seed=5)
    seeds = [np.random.SeedSequence(5, spawn_key=(i,)) for i in range(3)]
    for _ in range(2):
        rows = batch.reset().observation
        for i, seed in enumerate(seeds):
            alone = octarm.load(start="moving", seed=seed)
            alone.task.next_episode = batch.task.episode
            seen = alone.reset().observation
            np.testing.assert_array_equal(rows["q"][i], seen["q"])
            np.testing.assert_array_equal(rows["v"][i], seen["v"])


@pytest.mark.parametrize("layout", ["paper", "centred"])
def test_a_plant_of_more_modules_starts_where_its_arm_would(layout: str):
    """The three modules of which the controller knows; a plant hangs a little differently."""
    fine = octarm.load(start="moving", plant_modules=9, layout=layout, timestep=1e-4)
    coarse = octarm.load(start="moving", timestep=1e-4)
    seen, other = fine.reset().observation, coarse.reset().observation
    moved = [x["q"] - e.physics.hanging() for x, e in ((seen, fine), (other, coarse))]
    np.testing.assert_allclose(moved[0], moved[1], atol=1e-14)
    np.testing.assert_allclose(seen["v"], other["v"], atol=1e-13)
    groups = Groups.of(P, 9, layout)
    change = np.arange(1.0, 7.0)
    np.testing.assert_allclose(groups.rates(groups.spread(change)), change)


def test_a_drawn_start_leaves_the_noise_as_it_was():
    noise = [parse_disturbance("noise:0.4")]
    forces = []
    for start in ("rest", "random"):
        environment = octarm.load(disturbances=noise, start=start, seed=2)
        environment.reset()
        environment.step(np.zeros(6))
        forces.append(environment.physics.disturbance())
    np.testing.assert_array_equal(*forces)


def test_episodes_end_by_themselves():
    for duration, steps in ((None, 1000), (0.5, 50)):
        environment = octarm.load(
            "set-point", control_period=0.01, timestep=0.002, duration=duration
        )
        environment.reset()
        count = 1
        while not (step := environment.step(np.zeros(6))).last():
            count += 1
        assert count == steps and step.discount == 1.0


class Nothing:
    """No force at all."""

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> None:
        del batch_shape

    def __call__(self, state: None, measurement: Any, reference: Any) -> tuple[Command, None]:
        del reference
        return Command(np.zeros_like(measurement.q)), state


def test_a_loop_lasts_as_long_as_it_is_asked_to():
    """Unless a shorter duration was given; afterwards episodes end by themselves again."""
    environment = octarm.load("set-point", control_period=0.1, timestep=0.002)
    assert len(octarm.rollout(environment, Nothing(), 15.0).t) == 150
    environment.reset()
    while not environment.step(np.zeros(6)).last():
        pass
    assert environment.task.time == pytest.approx(10.0)
    short = octarm.load("set-point", control_period=0.1, timestep=0.002, duration=1.0)
    assert len(octarm.rollout(short, Nothing(), 15.0).t) == 10


@pytest.mark.parametrize(
    ("setting", "words"),
    [
        ({"start": "moved"}, "unknown start 'moved'; known are rest, random, moving"),
        ({"start": "random", "start_share": 1.5}, "start_share is 1.5; it must be above 0 and at"),
        ({"start_share": "a"}, "start_share is 'a'; it must be a number"),
    ],
)
def test_what_no_start_is(setting: dict[str, Any], words: str):
    with pytest.raises(OctarmError, match=words):
        octarm.load(**setting)


def test_a_run_that_begins_elsewhere_is_recorded_and_repeated(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    words = ["run", "--duration", "0.02", "--start", "moving", "--start-share", "5%"]
    assert main([*words, "--seed", "3", "--out", "a"]) == 0
    assert main([*words, "--seed", "4", "--out", "b"]) == 0
    run, other = (octarm.read_run(name) for name in ("a", "b"))
    seen = octarm.load(start="moving", start_share=0.05, seed=3).reset().observation
    np.testing.assert_array_equal(run.trajectory.q[0], seen["q"])
    np.testing.assert_array_equal(run.trajectory.v[0], seen["v"])
    assert np.all(run.trajectory.q[0] != other.trajectory.q[0])
    assert (run.description["start"], run.description["start_share"]) == ("moving", 0.05)
    assert "moving start" in title_of(run.description)
    both = differences([run.description, other.description])
    assert "seed" in [each.name for each in both if each.of_the_task]
    assert main(["verify", "a"]) == 0
    assert main(["run", "--duration", "0.02", "--out", "still"]) == 0
    still = octarm.read_run("still").description
    assert not {"start", "start_share"} & still.keys()
    (start,) = [d for d in differences([run.description, still]) if d.name == "start"]
    assert start.values == ["moving", "rest"] and start.of_the_task


def test_a_sweep_begins_where_its_spec_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    text = 'start = "random"\nstart_share = "5%"\nduration = 0.02\nepisodes = 2\n'
    text += '[grid]\ncontroller = ["pd", "smc"]\n[record]\nepisodes = [1]\n'
    spec = parse_spec(text)
    assert (spec.start, spec.start_share) == ("random", 0.05) and parse_spec(spec.to_toml()) == spec
    usual = parse_spec(text.replace('start = "random"\nstart_share = "5%"\n', ""))
    assert not {"start", "start_share"} & usual.content().keys() and spec.hash() != usual.hash()
    with pytest.raises(OctarmError, match="it must be above 0"):
        parse_spec(text.replace("5%", "0%"))
    Path("spec.toml").write_text(text)
    assert main(["sweep", "spec.toml", "--out", "s", "--workers", "1"]) == 0
    peaks = octarm.read_sweep("s")["peak_input_tau1"].to_numpy().reshape(2, 2)
    assert np.all(peaks[:, 0] != peaks[:, 1])  # each seed has a start of its own
    run = octarm.read_run("s/recorded/1-chosen")
    limits = Start.of(P, "random", 0.05)
    assert limits is not None
    moved = run.trajectory.q[0] - octarm.load().physics.hanging()
    assert np.all((moved >= limits.low) & (moved <= limits.high)) and np.any(moved)
    assert main(["verify", "s/recorded/1-chosen"]) == 0
    assert main(["verify", "s", "--episode", "3"]) == 0

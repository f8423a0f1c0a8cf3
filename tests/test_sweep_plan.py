"""How the episodes of a sweep are counted, seeded and put into batches."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from octarm.disturbances.forces import BandLimitedNoise
from octarm.disturbances.streams import stream
from octarm.sweeps.plan import Plan
from octarm.sweeps.spec_file import parse_spec

SPEC = """\
seed = 5
episodes = 3
batch = 7
[grid]
controller = ["smc", "pd"]
mismatch = [-0.3, 0.3]
[grid.disturbance]
noise = [0.0, 0.4]
drift.rate = [0.0, 0.1]
drift.of = ["stiffness", "damping"]
[random.disturbance]
payload = { low = 0.1, high = 0.3 }
tilt = { low = -0.1, high = 0.1, method = "sobol" }
actuation-delay = { low = 0.0, high = 0.01, method = "sobol" }
[disturbance]
noise.time = 0.05
"""


def every_value(plan: Plan) -> dict[str, np.ndarray]:
    return plan.values(np.arange(plan.episodes))


def test_every_cell_has_every_seed_once():
    plan = Plan(parse_spec(SPEC))
    values = every_value(plan)
    axes = [axis.name for axis in plan.spec.axes]
    seeds = plan.seeds(np.arange(plan.episodes)).tolist()
    rows = list(zip(*(values[name].tolist() for name in axes), seeds, strict=True))
    wanted = itertools.product(*(axis.values for axis in plan.spec.axes), range(3))
    assert rows == list(wanted)


@given(episodes=st.integers(1, 40), batch=st.integers(1, 50), mismatches=st.integers(1, 4))
def test_shards_hold_every_episode_once_and_no_more_than_a_batch(episodes, batch, mismatches):
    wrong = [0.1 * i for i in range(mismatches)]
    plan = Plan(
        parse_spec(
            f'episodes = {episodes}\nbatch = {batch}\n[grid]\ncontroller = ["pd", "smc"]\n'
            f'mismatch = {wrong}\nreference = ["sine", "set-point"]'
        )
    )
    assert list(itertools.chain(*map(plan.shard, plan.shards))) == list(range(plan.episodes))
    sizes = [len(shard) for shard in map(plan.shard, plan.shards)]
    assert max(sizes) <= batch
    assert max(sizes) - min(sizes) <= 1
    values = every_value(plan)
    for shard in map(plan.shard, plan.shards):
        for name in ("controller", "reference"):
            assert len(set(values[name][shard.start : shard.stop].tolist())) == 1


def test_arms_of_a_shard_agree_in_all_that_a_batch_shares():
    plan = Plan(parse_spec(SPEC))
    for shard in map(plan.shard, plan.shards):
        values = plan.values(np.array(shard))
        assert all(len(set(values[name])) == 1 for name in ("controller", "reference", "drift.of"))


def test_controllers_and_cells_have_the_same_random_numbers():
    plan = Plan(parse_spec(SPEC))
    numbers = np.arange(plan.episodes)
    values, seeds = every_value(plan), plan.seeds(numbers)
    for i in range(3):
        own = numbers[seeds == i]
        for name in ("payload", "tilt", "actuation-delay"):
            assert len(set(values[name][own])) == 1
        states = {tuple(s.generate_state(4)) for s in (plan.episode(n).seeds[0] for n in own)}
        root = np.random.SeedSequence(5, spawn_key=(i,))
        assert states == {tuple(root.generate_state(4))}
    assert len(set(values["payload"])) == 3


def test_an_episode_alone_is_what_it_is_in_its_batch():
    plan = Plan(parse_spec(SPEC))
    for shard in map(plan.shard, plan.shards):
        together = plan.arms(shard)
        for i, number in enumerate(shard):
            alone = plan.episode(number)
            assert alone.batch is None and together.batch == len(shard)
            assert alone.controller == together.controller
            assert alone.mismatch == np.broadcast_to(together.mismatch, len(shard))[i]
            assert alone.seeds[0].spawn_key == together.seeds[i].spawn_key
            for one, many in zip(alone.disturbances, together.disturbances, strict=True):
                assert type(one) is type(many)
                for field, value in vars(one).items():
                    other = np.asarray(getattr(many, field))
                    assert value == (other.reshape(-1)[i] if other.ndim else other)


def test_fixed_fields_hold_for_all():
    plan = Plan(parse_spec(SPEC))
    for shard in map(plan.shard, plan.shards):
        (noise,) = [d for d in plan.arms(shard).disturbances if isinstance(d, BandLimitedNoise)]
        assert noise.correlation_time == 0.05


def test_more_seeds_leave_the_first_ones_as_they_are():
    few = every_value(Plan(parse_spec(SPEC)))
    many = Plan(parse_spec(SPEC.replace("episodes = 3", "episodes = 100")))
    drawn = many.values(np.arange(3))
    for name in ("payload", "tilt", "actuation-delay"):
        assert np.array_equal(few[name][:3], drawn[name])


def test_uniform_draws_do_not_depend_on_the_other_axes():
    alone = SPEC[: SPEC.index("tilt =")] + SPEC[SPEC.index("[disturbance]\n") :]
    assert np.array_equal(
        every_value(Plan(parse_spec(alone)))["payload"][:3],
        every_value(Plan(parse_spec(SPEC)))["payload"][:3],
    )
    draw = stream(np.random.SeedSequence(5), "axis payload").random(3)
    assert np.array_equal(
        every_value(Plan(parse_spec(SPEC)))["payload"][:3], 0.1 + (0.3 - 0.1) * draw
    )


def test_drawn_values_fill_their_range():
    plan = Plan(parse_spec(SPEC.replace("episodes = 3", "episodes = 256")))
    values = plan.values(np.arange(256))
    for axis in plan.spec.random:
        low, high = map(float, axis.values)
        share = (values[axis.name] - low) / (high - low)
        assert np.all((share >= 0.0) & (share <= 1.0))
        counts = np.histogram(share, 16, (0.0, 1.0))[0]
        # A Sobol sequence of 2^8 points, turned, has 16 in each part but for what is cut at its
        # ends; independent ones have 16 +- 4.
        assert np.all(abs(counts - 16) <= (1 if axis.method == "sobol" else 16))


def test_other_seeds_give_other_draws():
    one, two = (
        every_value(Plan(parse_spec(SPEC.replace("seed = 5", f"seed = {seed}")))) for seed in (5, 6)
    )
    for name in ("payload", "tilt", "actuation-delay"):
        assert not np.any(one[name] == two[name])


def test_probes_show_every_value_of_every_axis():
    plan = Plan(parse_spec(SPEC))
    probes = plan.probes()
    assert len(probes) == 2 * 2  # controllers and words
    shown = plan.values(np.concatenate(probes))
    everything = every_value(plan)
    for axis in plan.spec.axes:
        assert set(shown[axis.name]) == set(everything[axis.name])


def test_an_unknown_episode_is_refused():
    plan = Plan(parse_spec(SPEC))
    with pytest.raises(ValueError, match=r"no episode 96; they are numbered 0 \.\. 95"):
        plan.episode(96)

"""A shard's rows: the same as those of its episodes run one by one, whatever acts on them."""

import functools

import numpy as np
import pytest

from controllers import CONTROLLERS, make_controller
from octarm.metrics.table import METRICS
from octarm.runs.digest import CHECKPOINTS, StateDigest
from octarm.simulation.rollout import simulate
from octarm.sweeps.plan import Plan
from octarm.sweeps.shards import begin, run_arms, run_shard, schema
from octarm.sweeps.spec_file import parse_spec

# Gains that stand the delays of EVERYTHING, and not the model error of WILD, whatever is tuned.
FACTORY = functools.partial(make_controller, gain_set="recommended")

EVERYTHING = """\
episodes = 2
duration = 0.02
{controller}
[grid]
mismatch = [-0.3, 0.0, 0.3]
[grid.disturbance]
noise = [0.0, 0.4]
[random.disturbance]
payload = {{ low = 0.0, high = 0.3 }}
measurement-noise = {{ low = 0.0, high = 0.001, method = "sobol" }}
actuation-delay = {{ low = 0.0, high = 0.003 }}
measurement-delay = {{ low = 0.0, high = 0.003 }}
tilt = {{ low = -0.2, high = 0.2 }}
loss = {{ low = 0.0, high = 0.3 }}
drift = {{ low = -0.5, high = 0.5 }}
"""


def comparable(table):
    return table.drop_columns("wall_time").replace_schema_metadata(None)


@pytest.mark.parametrize("name", CONTROLLERS)
def test_rows_are_those_of_the_episodes_run_alone(name: str):
    spec = parse_spec(EVERYTHING.format(controller=f'controller = "{name}"'))
    plan = Plan(spec)
    table = comparable(run_shard(spec, 0, FACTORY))
    assert table["episode"].to_pylist() == list(range(12))
    assert set(table["status"].to_pylist()) == {"ok"}
    for i in (0, 7, 11):
        alone = comparable(run_arms(plan, plan.episode(i), FACTORY))
        assert alone.equals(table.slice(i, 1))


def test_rows_do_not_depend_on_how_the_arms_are_put_together():
    spec = parse_spec(EVERYTHING.format(controller='controller = "smc"'))
    plan = Plan(spec)
    order = np.random.default_rng(0).permutation(12)
    whole = comparable(run_shard(spec, 0, FACTORY))
    shuffled = comparable(run_arms(plan, plan.arms(order), FACTORY))
    assert shuffled.equals(whole.take(order))


# Forces that come 20 ms late make it lose the arm within 0.1 s.
WILD = """\
controller = "computed-torque"
duration = 0.2
episodes = 1
[grid.disturbance]
actuation-delay = [0.0, 0.02]
"""


def test_an_arm_that_diverges_has_a_row_without_measures():
    spec = parse_spec(WILD)
    plan = Plan(spec)
    calm, wild = comparable(run_shard(spec, 0, FACTORY)).to_pylist()
    assert (calm["status"], wild["status"]) == ("ok", "diverged")
    assert calm["diverged_at"] is None and 0.0 < wild["diverged_at"] < 0.2
    assert calm["effort_tau1"] > 0.0 and wild["effort_tau1"] is None
    # The digest covers what came before, and says no more afterwards.
    assert wild["checkpoints"][-1] == wild["digest"] == wild["checkpoints"][-2]
    assert len(set(wild["checkpoints"])) > 1
    assert len(set(calm["checkpoints"])) == CHECKPOINTS
    alone = comparable(run_arms(plan, plan.episode(1), FACTORY))
    assert alone.to_pylist() == [wild]


def test_columns_are_the_same_for_all_controllers_and_metrics_say_their_unit():
    spec = parse_spec('duration = 0.005\n[grid]\ncontroller = ["pd", "smc"]')
    tables = [run_shard(spec, i, FACTORY) for i in range(2)]
    assert tables[0].schema.equals(tables[1].schema)
    assert tables[0].schema.equals(schema(spec))
    units = {field.name: (field.metadata or {}).get(b"unit") for field in tables[0].schema}
    assert units["rms_error_s1"] == b"m" and units["rms_error_theta1"] == b"rad"
    assert units["effort_tau6"] == b"N" and units["tip_rms_error"] == b"m"
    for metric in METRICS:
        assert any(name.startswith(metric) for name in units)
    # What a controller does not report is null: a reaching bound, without a declared uncertainty.
    assert tables[1]["reaching_bound"].null_count == 1
    assert tables[1]["sliding_violations_s1"].null_count == 0


def random_states(steps: int, arms: int) -> np.ndarray:
    return np.random.default_rng(1).normal(size=(steps, 2, arms, 6))


def digest_of(states: np.ndarray) -> np.ndarray:
    digest = StateDigest(len(states))
    for q, v in states:
        digest.update(q, v)
    return digest.result()[0]


def test_any_bit_of_any_state_changes_the_digest():
    states = random_states(3, 1)
    found = {int(digest_of(states)[0])}
    bits = states.view(np.uint64).reshape(-1)
    for place in range(bits.size):
        for bit in range(64):
            bits[place] ^= np.uint64(1 << bit)
            found.add(int(digest_of(states)[0]))
            bits[place] ^= np.uint64(1 << bit)
    assert len(found) == 1 + bits.size * 64


def test_signs_and_order_count_in_the_digest():
    states = random_states(2, 5)
    mirrored, turned = states.copy(), states[::-1].copy()
    mirrored[..., 3:] *= -1.0  # an even number of sign bits
    swapped = states[:, ::-1].copy()
    for other in (mirrored, turned, swapped):
        assert not np.any(digest_of(other) == digest_of(states))


def test_the_digest_of_an_arm_does_not_depend_on_the_memory_order():
    states = random_states(4, 5)
    columns = np.ascontiguousarray(states.transpose(0, 1, 3, 2)).transpose(0, 1, 3, 2)
    assert np.array_equal(digest_of(columns), digest_of(states))
    for i in range(5):
        assert digest_of(states[:, :, i])[0] == digest_of(states)[i]


@pytest.mark.parametrize("periods", [1, 7, 20, 33, 400])
def test_checkpoints_are_the_digests_of_equal_parts(periods: int):
    states = random_states(periods, 2)
    digest = StateDigest(periods)
    for q, v in states:
        digest.update(q, v)
    value, checkpoints = digest.result()
    assert checkpoints.shape == (2, CHECKPOINTS)
    assert np.array_equal(checkpoints[:, -1], value)
    for k in range(CHECKPOINTS):
        so_far = -(-(k + 1) * periods // CHECKPOINTS)
        assert np.array_equal(checkpoints[:, k], digest_of(states[:so_far]))


def test_the_digest_is_that_of_the_states_of_the_loop():
    spec = parse_spec('controller = "smc"\nduration = 0.01\n[disturbance]\nnoise = 0.4')
    plan = Plan(spec)
    environment, controller = begin(spec, plan.episode(0), FACTORY)
    digest = StateDigest(20)
    simulate(environment, controller, 0.01, lambda instant: digest.update(instant.q, instant.v))
    row = run_shard(spec, 0, FACTORY).to_pylist()[0]
    assert row["digest"] == digest.result()[0][0]
    assert row["checkpoints"] == digest.result()[1][0].tolist()

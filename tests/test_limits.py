"""Numbers beyond every use are refused at once, with the limit; large sweeps are only estimated."""

import itertools
import resource
import subprocess
import sys

import numpy as np
import pytest

from controllers import make_controller
from octarm import memory
from octarm.checks.validation import arm_with, validate
from octarm.commands.app import parse
from octarm.errors import OctarmError
from octarm.simulation.environment import load
from octarm.sweeps.execute import estimate, rehearse, sweep
from octarm.sweeps.plan import Plan
from octarm.sweeps.spec_file import parse_spec
from octarm.sweeps.tune import Budget

HUGE = """
episodes = 1000000000000
duration = 0.01
[grid]
controller = ["pd", "smc"]
mismatch = [-0.3, 0.3]
[random.disturbance]
payload = { low = 0.1, high = 0.3 }
tilt = { low = -0.1, high = 0.1, method = "sobol" }
"""


@pytest.mark.parametrize("period", [8.5e172, 5e4, 10.1, np.inf])
def test_a_control_period_that_controls_nothing_is_refused(period: float):
    for timestep in (None, "auto"):
        with pytest.raises(OctarmError, match=r"control period is .* must be at most 10 s: an arm"):
            load(control_period=period, timestep=timestep)


@pytest.mark.parametrize("period", [0.0, -1.0, np.nan])
def test_a_control_period_is_positive(period: float):
    with pytest.raises(OctarmError, match=r"control period is .* must be a whole multiple of"):
        load(control_period=period)
    with pytest.raises(OctarmError, match=r"control period is .* must be positive"):
        load(control_period=period, timestep="auto")


def test_a_control_period_of_more_steps_than_a_million_is_refused():
    with pytest.raises(OctarmError, match=r"control period is 0.2 s; .* at most 0.1 s"):
        load(control_period=0.2, timestep=1e-7)


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("control_period = 5e4", r"control_period is 50000.0; it must be at most 10"),
        ("timestep = 1e-300", r'timestep is 1e-300; it must be "auto", or a number from 1e-07'),
        ('timestep = "automatic"', r'timestep is "automatic"; it must be "auto", or a number'),
        ("episodes = 10000000000000000", r"10000000000000000 episodes; it must be at most"),
        ("seed = 9223372036854775808", r"seed is 9223372036854775808; it must be at most"),
        ("duration = 1e300", r"duration is 1e\+300 s; it must be at most"),
    ],
)
def test_a_spec_of_such_numbers_is_refused(text: str, sentence: str):
    with pytest.raises(OctarmError, match=sentence):
        rehearse(Plan(parse_spec(f'{text}\n[grid]\ncontroller = ["pd"]')), make_controller)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["run", "--seed", "9223372036854775808"], r"seed is 9223372036854775808; .* at most 922"),
        (["sweep", "x.toml", "--workers", "4097"], r"workers is 4097; it must be at most 4096"),
        (["validate", "--modules", "61"], r"modules is 61; it must be at most 60"),
        (["validate", "--states", "1000001"], r"states is 1000001; it must be at most 1000000"),
        (["validate", "--random-parameters", "10001"], r"random-parameters is 10001; .* 10000"),
        (["tune", "pd", "--budget", "1e9"], r"budget is 1e\+09 s; .* at most 1e\+08 s"),
        (
            "margin pd --disturbance payload --bound tip_rms_error:1 --seeds 1000000000".split(),
            r"9000000000 arms of 3 modules side by side take about .* GB .* are available",
        ),
    ],
)
def test_a_command_line_of_such_numbers_is_refused(words: list[str], sentence: str):
    with pytest.raises(OctarmError, match=sentence):
        parse(words)()


def test_the_budget_of_a_search_ends_somewhere():
    assert Budget.within(1e8).generations > 5e4
    with pytest.raises(OctarmError, match=r"and finite, at most 1e\+08 s"):
        Budget.within(np.inf)


@pytest.mark.parametrize("arms", [10**12, 10**30, 0, -1])
def test_a_batch_larger_than_memory_is_refused_before_it_is_allocated(arms: int):
    sentence = r"GB of memory, of which .* GB are available" if arms > 0 else r"at least 1"
    with pytest.raises(OctarmError, match=sentence):
        load(batch=arms)


@pytest.mark.parametrize("threads", [0, -1, 1025, 10**9])
def test_more_threads_than_any_machine_has_are_refused(threads: int):
    with pytest.raises(OctarmError, match=r"threads is -?\d+; it must be at least 1 and at most"):
        load(batch=2, threads=threads)


def test_a_batch_that_is_estimated_to_fit_does_so():
    """The estimate is between what the arms take and ten times of it, peak memory counted."""
    code = (
        "import octarm\n"
        "from controllers import make_controller\n"
        "from octarm.sweeps.shards import measure\n"
        "from octarm.arm.mjcf import nominal_parameters\n"
        "def peak():\n"
        "    with open('/proc/self/status') as file:\n"
        "        return next(int(x.split()[1]) for x in file if x.startswith('VmHWM'))\n"
        "law = make_controller('afsmc', nominal_parameters())\n"
        "measure(octarm.load(batch=1), law, 0.005)\n"
        "before = peak()\n"
        "measure(octarm.load(batch=8192), law, 0.005)\n"
        "print(1024 * (peak() - before))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    measured = float(done.stdout)
    assert measured / 1.5 < 8192 * 3 * memory.ARM < 10.0 * measured


def test_the_limit_of_a_process_counts_as_well(monkeypatch):
    free = memory.available()
    used = memory.psutil.Process().memory_info().vms
    monkeypatch.setattr(resource, "getrlimit", lambda kind: (used + 5e8, used + 5e8))
    assert memory.available() <= min(free * 1.5, 5.2e8)
    with pytest.raises(OctarmError, match=r"take about 12 GB of memory"):
        load(batch=1_000_000)


def test_states_beyond_memory_are_refused():
    with pytest.raises(OctarmError, match=r"states of an arm of 3 modules take about 3.6e\+06 GB"):
        validate(arm_with(3), states=10**12)


# Sweeps


def test_a_huge_sweep_is_estimated_from_its_first_shards():
    spec = parse_spec(HUGE)
    forecast = estimate(spec, make_controller)
    assert forecast.episodes == 4 * 10**12
    assert forecast.shards == len(Plan(spec).shards) == 2 * -(-2 * 10**12 // 1024)
    assert forecast.seconds > 4 * 10**12 * 1e-5 and forecast.size > 10**14


def test_a_huge_sweep_is_not_begun(tmp_path):
    with pytest.raises(OctarmError, match=r"has 3906250000 shards; it must have at most 100000"):
        sweep(parse_spec(HUGE), make_controller, tmp_path / "sweep")
    assert not (tmp_path / "sweep").exists()


def test_the_batch_of_a_sweep_is_checked_against_memory():
    with pytest.raises(OctarmError, match=r"2000000000000 arms of 3 modules side by side take"):
        estimate(parse_spec("batch = 4000000000000\n" + HUGE), make_controller)


def test_a_dry_run_says_that_the_sweep_is_too_large(tmp_path, capsys):
    file = tmp_path / "huge.toml"
    file.write_text(HUGE)
    assert parse(["sweep", str(file), "--dry-run"])() == 0
    said = capsys.readouterr().out
    assert "4000000000000 episodes of 0.01 s in 3906250000 shards" in said
    assert "octarm sweep will refuse it: the sweep has 3906250000 shards" in said


@pytest.mark.parametrize(("episodes", "batch"), [(1, 1), (7, 3), (40, 50), (13, 1)])
def test_shards_are_a_sequence_of_ranges(episodes: int, batch: int):
    text = f'episodes = {episodes}\nbatch = {batch}\n[grid]\ncontroller = ["pd", "smc", "fsmc"]\n'
    plan = Plan(parse_spec(text + "mismatch = [0.1, 0.2]"))
    shards = [plan.shard(i) for i in plan.shards]
    assert list(itertools.chain(*shards)) == list(range(6 * episodes))
    with pytest.raises(IndexError):
        plan.shard(len(shards))


def test_what_is_drawn_for_a_seed_does_not_depend_on_how_it_is_asked_for():
    few, many = Plan(parse_spec(HUGE)), Plan(parse_spec(HUGE))
    whole = many.values(np.arange(3000))
    for first in (0, 5, 1023, 2999):
        part = few.values(np.arange(first, min(first + 4, 3000)))
        for name in ("payload", "tilt"):
            np.testing.assert_array_equal(part[name], whole[name][first : first + 4])
    assert len(set(whole["tilt"].tolist())) == 3000


def test_physics_steps_of_a_period_that_memory_cannot_hold_are_refused(monkeypatch):
    monkeypatch.setattr("octarm.memory.available", lambda: 5e8)
    load(timestep=1e-5, control_period=1.0)
    with pytest.raises(OctarmError, match="1000000 physics steps in a control period take about"):
        load(timestep=1e-5, control_period=10.0)
    with pytest.raises(OctarmError, match="2000 physics steps of 500 arms in a control period"):
        load(timestep=1e-3, control_period=2.0, batch=500)

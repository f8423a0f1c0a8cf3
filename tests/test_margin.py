"""Margins with known answers: of made-up errors, and of an arm whose static error is known."""

import csv
import dataclasses
import json
import math
import re

import numpy as np
import pytest
from arm_states import hand_set
from scipy.stats import binom

from octarm.arm.lagrange import potential_force
from octarm.arm.mjcf import nominal_parameters
from octarm.arm.parameters import ArmParameters
from octarm.commands import margin as margin_commands
from octarm.commands.cli import main
from octarm.commands.many_runs import MarginOptions
from octarm.disturbances.forces import PulseForce
from octarm.disturbances.spelling import DISTURBANCES, parse_disturbance
from octarm.disturbances.varied import NOMINAL, is_varied, parse_varied, usual_range
from octarm.interfaces import Command
from octarm.metrics.table import parse_bound
from octarm.sweeps.margin import Attempt, Brackets, MarginRuns, margin_of, search, seeds_needed

P = nominal_parameters()


class Proportional:
    """An error that grows with the share of the way; each seed breaks the bound at its own one."""

    def __init__(self, *margins: float) -> None:
        self.margins = np.array(margins)
        self.calls = []

    def __call__(self, seeds, shares):
        self.calls.append((seeds.copy(), shares.copy()))
        return Attempt(shares / self.margins[seeds], seeds)


def test_the_margin_of_each_seed_is_found():
    margins = 0.7, 0.31, 0.125, 0.999, 0.0123, 0.0027
    found = search(Proportional(*margins), len(margins), resolution=0.01)
    assert np.all(found.met <= margins) and np.all(margins < found.failed)
    assert np.all(found.failed - found.met <= 0.01 * found.failed)
    assert np.array_equal(found.margins, found.met)
    assert not found.again.any() and not found.alike


def test_a_finer_resolution_closes_in_and_costs_little():
    attempt = Proportional(0.3, 0.55)
    found = search(attempt, 2, resolution=1e-4)
    np.testing.assert_allclose(found.met, [0.3, 0.55], rtol=1e-4)
    assert len(attempt.calls) <= 1 + math.ceil(math.log(1e4, 4))


def test_the_margin_of_a_seed_does_not_depend_on_the_others():
    margins = 0.7, 0.31, 0.0123, 2.0, 0.9
    together = search(Proportional(*margins), 5)
    for i in range(1, 5):
        fewer = search(Proportional(*margins), i)
        assert np.array_equal(fewer.met, together.met[:i])
        assert np.array_equal(fewer.failed, together.failed[:i])


def test_every_seed_meets_the_same_values_on_the_grid():
    attempt = Proportional(0.7, 0.3)
    found = search(attempt, 2, intervals=4)
    seeds, shares = attempt.calls[0]
    assert shares[seeds == 0].tolist() == shares[seeds == 1].tolist() == [0.0, 0.25, 0.5, 0.75, 1.0]
    np.testing.assert_allclose(found.excess, np.outer([1 / 0.7, 1 / 0.3], found.grid))


def test_beyond_the_range_and_below_it_there_is_no_number():
    def attempt(seeds, shares):
        return Attempt(np.array([0.4, 1.0, 1.1])[seeds] + 0.0 * shares, seeds)

    found = search(attempt, 3)
    assert found.margins.tolist() == [np.inf, np.inf, -np.inf]
    assert found.met.tolist() == [1.0, 1.0, -np.inf]
    assert found.failed.tolist() == [np.inf, np.inf, 0.0]


def test_what_diverges_breaks_the_bound():
    def attempt(seeds, shares):
        return Attempt(np.where(shares > 0.4, np.inf, 0.1), seeds)

    found = search(attempt, 1)
    assert found.met[0] <= 0.4 < found.failed[0]


def test_a_bound_that_is_met_again_further_on_is_noticed():
    def attempt(seeds, shares):
        island = (seeds == 1) & (shares > 0.7) & (shares < 0.8)
        return Attempt(np.where((shares <= 0.3) | island, 0.5, 2.0), seeds)

    found = search(attempt, 2)
    assert found.again.tolist() == [False, True]
    assert np.all(np.abs(found.met - 0.3) < 0.003)  # the first failure


def test_an_island_within_a_gap_is_noticed_too():
    def attempt(seeds, shares):
        return Attempt(np.where((shares < 0.13) | (abs(shares - 0.1875) < 0.01), 0.5, 2.0), seeds)

    assert search(attempt, 1).again.all()


def test_seeds_that_are_alike_are_run_once():
    calls = []

    def attempt(seeds, shares):
        calls.append(seeds)
        return Attempt(shares / 0.3, np.round(1e6 * shares))

    found = search(attempt, 5)
    assert found.alike
    assert len(found.met) == 5 and len(set(found.met.tolist())) == 1
    assert all((seeds == 0).all() for seeds in calls[1:])
    assert math.isnan(margin_of(found, 0.9).low)


def brackets(*margins: float) -> Brackets:
    values = np.array(margins)
    return Brackets(
        met=np.minimum(values, 1.0),
        failed=np.where(np.isinf(values) & (values > 0.0), np.inf, np.maximum(values, 0.0) + 0.01),
        again=np.zeros(len(values), dtype=bool),
        grid=np.zeros(1),
        excess=np.zeros((len(values), 1)),
        alike=False,
    )


def test_the_margin_is_what_the_share_of_the_seeds_bears():
    tenths = brackets(*np.arange(10, 0, -1) / 10.0)
    for share, value in ((1.0, 0.1), (0.9, 0.2), (0.85, 0.2), (0.5, 0.6), (0.1, 1.0), (0.01, 1.0)):
        assert margin_of(tenths, share).value == value
        assert np.mean(tenths.margins >= value) >= share


@pytest.mark.parametrize(("seeds", "share"), [(36, 0.9), (40, 0.9), (20, 0.5), (16, 0.6)])
def test_the_interval_leaves_a_fortieth_on_either_side(seeds, share):
    """Ends are order statistics; one place further in would leave more."""
    margins = np.sqrt(np.arange(1, seeds + 1)) / 7.0
    found = margin_of(brackets(*margins), share)
    low, high = (1 + int(np.flatnonzero(margins == end)[0]) for end in found[1:])
    below = binom(seeds, 1.0 - share)
    assert below.cdf(low - 1) <= 0.025 < below.cdf(low)
    assert below.sf(high - 1) <= 0.025 < below.sf(high - 2)
    assert found.low < found.value < found.high


@pytest.mark.parametrize("share", [0.5, 0.9, 1.0])
@pytest.mark.parametrize("seeds", [2, 16, 36])
def test_intervals_hold_the_margin_as_often_as_they_say(seeds, share):
    """They are exact and may hold it more often; an end that is missing is infinite."""
    draws = np.random.default_rng(seeds).exponential(size=(2000, seeds))
    exact = -np.log(share)  # which a share of all margins is above
    held = 0
    for margins in draws:
        found = margin_of(brackets(*margins), share)
        held += not (found.low > exact or found.high < exact)
    assert held / 2000 >= 0.93


def test_too_few_seeds_have_no_end_and_it_is_known_how_many_would():
    assert seeds_needed(0.9) == (36, 2)  # 0.9^36 = 0.0225, 0.9^35 = 0.0250
    assert seeds_needed(1.0) == (math.inf, 1) and seeds_needed(0.5) == (6, 6)
    for share, seeds in ((0.9, 36), (0.95, 72), (0.5, 6)):
        for n, known in ((seeds - 1, False), (seeds, True)):
            found = margin_of(brackets(*np.arange(1.0, n + 1.0) / n), share)
            assert math.isfinite(found.low) == known
            assert math.isfinite(found.high) or n < seeds_needed(share)[1]
    every = margin_of(brackets(*np.arange(1.0, 101.0) / 100.0), 1.0)
    assert math.isnan(every.low) and every.high == every.value == 0.01


def test_margins_beyond_the_range_have_their_place_in_the_order():
    found = margin_of(brackets(0.2, 0.3, *[np.inf] * 8), 0.5)
    assert found.value == np.inf
    assert found.low == 0.3 and found.high == np.inf
    lost = margin_of(brackets(*[-np.inf] * 9, 0.5), 0.5)
    assert (lost.value, lost.low) == (-np.inf, -np.inf)


@dataclasses.dataclass(frozen=True, eq=False)
class Spring:
    """Q = G_nominal(q_d) - k e - b e', whose static error of s1 is known exactly.

    The weight of all that hangs below s1 acts along it, whatever the bends are, so that a further
    force F on it gives e_s1 = F / (k + both columns' stiffness).
    """

    nominal: ArmParameters
    k: float = 600.0
    b: float = 30.0

    def initial_state(self, batch_shape=()):
        del batch_shape

    def __call__(self, state, measurement, reference):
        gains = np.repeat([[self.k], [self.b]], 6, axis=1) * np.repeat([1.0, 0.01], 3)
        e, rate = measurement.q - reference.q, measurement.v - reference.v
        force = potential_force(self.nominal, reference.q) - gains[0] * e - gains[1] * rate
        return Command(force, {}), state


def trial(text: str, bound: str, low=None, high=None, **options) -> MarginRuns:
    plain = {
        "factory": Spring,
        "reference": "set-point",
        "duration": 2.1,
        "timestep": 0.002,
        "bounds": [parse_bound(bound)],
    }
    return MarginRuns(varied=parse_varied(text, low, high), **(plain | options))


STIFFNESS = 600.0 + 2.0 * 1200.0  # [N/m], of the controller and of both columns of module 1


def found_margin(what: MarginRuns) -> float:
    what.rehearse()
    found = search(what, 2, intervals=4)
    assert found.alike and not found.again.any()
    return float(what.varied.at(found.met[0]))


def test_the_payload_that_stretches_the_arm_to_the_bound():
    exact = 0.001 * STIFFNESS / 9.81
    assert found_margin(trial("payload", "rms_error_s1:0.001")) == pytest.approx(exact, rel=0.011)


def test_the_force_that_stretches_the_arm_to_the_bound_downwards():
    found = found_margin(trial("step:on=s1", "peak_error_s1:0.001", low=0.0, high=-8.0))
    assert found == pytest.approx(-0.001 * STIFFNESS, rel=0.011)


def test_the_model_error_that_moves_the_arm_to_the_bound():
    # Of the pull of the springs, M g, the model has 1 + X/2, of the weight 1 + X.
    weight = 9.81 * P.mass.sum()
    exact = 0.0005 * STIFFNESS * 2.0 / weight
    assert found_margin(trial(NOMINAL, "steady_error_s1:0.0005")) == pytest.approx(exact, rel=0.011)


def test_the_smallest_bound_counts():
    what = trial("payload", "rms_error_s1:0.001")
    both = dataclasses.replace(what, bounds=[("rms_error_s1", 1.0), *what.bounds])
    seeds, shares = np.zeros(3, dtype=int), np.array([0.0, 0.2, 0.9])
    assert np.array_equal(both(seeds, shares).excess, what(seeds, shares).excess)


@pytest.mark.slow
def test_the_delay_that_breaks_the_bound_is_not_bound_to_physics_steps():
    """It is borne at 3 ms and not at 3.5, and with finer steps breaks at the same one."""
    options = {"reference": "sine", "duration": 2.5, "control_period": 5e-4, "timestep": 5e-4}
    options["factory"] = lambda nominal: hand_set("pd", nominal)
    what = trial("actuation-delay", "tip_rms_error:0.003", low=0.0, high=0.004, **options)
    found = search(what, 1)
    met, failed = (float(what.varied.at(x[0])) for x in (found.met, found.failed))
    assert 0.003 < met < failed < 0.0035 and failed - met < 0.011 * failed
    fine = dataclasses.replace(what, timestep=1e-4, control_period=5e-4)
    grid = np.array([0.003, met - 5e-5, failed + 5e-5, 0.0035]) / 0.004
    excess = fine(np.zeros(4, dtype=int), grid).excess
    np.testing.assert_array_equal(excess <= 1.0, [True, True, False, False])


def noisy(**options) -> MarginRuns:
    return MarginRuns(
        factory=lambda nominal: hand_set("smc-boundary", nominal),
        varied=parse_varied("payload:at=0.5", 0.0, 0.4),
        bounds=[("tip_rms_error", 0.01)],
        disturbances=[parse_disturbance("noise:0.4")],
        duration=2.1,
        timestep=0.001,
        control_period=0.002,
        **options,
    )


def test_a_seed_meets_the_same_noise_at_every_value_and_in_any_batch():
    what = noisy()
    shares = np.array([0.3, 0.3, 0.3, 0.6])
    together = what(np.array([0, 1, 2, 1]), shares)
    assert len(set(together.excess.tolist())) == 4
    alone = what(np.array([1]), np.array([0.3]))
    assert (alone.excess[0], alone.digest[0]) == (together.excess[1], together.digest[1])


def test_threads_and_progress_change_nothing():
    seconds = []
    told = dataclasses.replace(noisy(), progress=seconds.append, threads=2)
    seeds, shares = np.array([0, 1]), np.array([0.0, 1.0])
    one, other = noisy()(seeds, shares), told(seeds, shares)
    assert np.array_equal(one.excess, other.excess) and np.array_equal(one.digest, other.digest)
    assert sum(seconds) == pytest.approx(2 * 2.1)


def test_an_arm_that_is_lost_breaks_the_bound():
    what = dataclasses.replace(noisy(), varied=parse_varied("actuation-delay", 0.0, 0.1))
    lost = what(np.array([0, 0]), np.array([0.0, 1.0]))
    assert lost.excess[0] < np.inf == lost.excess[1]


def test_a_measure_that_a_run_cannot_have_is_refused():
    short = dataclasses.replace(noisy(), duration=0.01)
    with pytest.raises(ValueError, match=r"tip_rms_error has no value in a run of 0\.01 s"):
        short(np.array([0]), np.array([0.0]))
    unknown = dataclasses.replace(noisy(), bounds=[("rms_error", 1.0)])
    with pytest.raises(ValueError, match=r"no measure 'rms_error' .* known are rms_error_s1, "):
        unknown.rehearse()


@pytest.mark.parametrize("name", [NOMINAL, *DISTURBANCES])
def test_anything_can_vary(name):
    low, high = usual_range(name) or (9.0, 1.0)
    varied = parse_varied(name, low, high)
    assert (varied.name, varied.low, varied.high) == (name, low, high)
    what = dataclasses.replace(noisy(), varied=varied)
    what.rehearse()
    assert varied.at(np.array([0.0, 0.5, np.inf])).tolist() == [low, 0.5 * (low + high), np.inf]


def test_the_other_fields_of_what_varies_are_kept():
    (pulse,) = parse_varied("pulse:at=1,length=0.2", 0.0, 2.0).of(np.array([0.5, 1.5]))
    assert isinstance(pulse, PulseForce) and isinstance(pulse.amplitude, np.ndarray)
    assert (pulse.at, pulse.length, pulse.amplitude.tolist()) == (1.0, 0.2, [0.5, 1.5])
    assert [is_varied(t) for t in ("noise", "pulse:at=1", "noise:0.4", "pulse:1,at=1")] == [
        True, True, False, False,
    ]  # fmt: skip


GOOD = ("--disturbance", "payload", "--bound", "tip_rms_error:0.01")
BAD = {
    (): "no controller is given",
    ("pd",): "no bound is given",
    ("pd", "--bound", "tip_rms_error:0.01"): "one --disturbance goes without a value.* it is none",
    ("pd", *GOOD, "--disturbance", "noise"): "it is payload and noise",
    ("pd", *GOOD[:3], "tip_rms_error"): "bound is 'tip_rms_error'; it must read METRIC:VALUE",
    ("pd", *GOOD[:3], "tip_rms_error:-1"): "bound of tip_rms_error is -1; it must be positive",
    ("pd", *GOOD[:3], "tip_rms_eror:1"): "no measure 'tip_rms_eror'.*did you mean 'tip_rms_error'",
    ("p", *GOOD): "unknown controller 'p'",
    ("pd", *GOOD, "--seeds", "0"): "seeds is 0; it must be at least 1",
    ("pd", *GOOD, "--share", "1.5"): "share is 1.5; it must be at most 1",
    ("pd", *GOOD, "--low", "1"): "low is 1 and high 1; they must be two finite numbers",
    ("pd", *GOOD, "--low", "-1"): "mass of payload is -1 kg; it must be at least 0 kg",
    ("pd", *GOOD, "--json", "no/file"): "no/file cannot be written: there is no folder for it",
    ("pd", "--disturbance", "payloat", *GOOD[2:]): "unknown disturbance 'payloat'.*'payload'",
    ("pd", "--disturbance", "slew", *GOOD[2:]): "slew has no usual range; give --low",
    ("pd", "--disturbance", "payload:a=1", *GOOD[2:]): "payload has no key 'a'",
    ("pd", "--disturbance", NOMINAL, "--mismatch", "1", *GOOD[2:]): "nominal-mismatch is what",
    ("pd", "--disturbance", NOMINAL, "--low", "-1", *GOOD[2:]): "mismatch is -1; it must be above",
}


@pytest.mark.parametrize("arguments", BAD, ids=" ".join)
def test_bad_input_is_one_sentence(arguments, capsys):
    assert main(["margin", *arguments]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    (line,) = err.splitlines()
    assert re.search(BAD[arguments], line), line


def test_the_command_prints_and_writes_what_it_found(tmp_path, capsys):
    files = ("--csv", str(tmp_path / "m.csv"), "--json", str(tmp_path / "m.json"))
    few = ("--seeds", "2", "--high", "0.4", "--share", "1", "--disturbance", "noise:0.4")
    short = ("--duration", "2.1", "--timestep", "0.001", "--control-period", "0.002")
    short = (*short, "--gains", "recommended")  # the tuned ones need a shorter control period
    assert main(["margin", "smc-boundary", *GOOD, *few, *short, *files]) == 0
    out, err = capsys.readouterr()
    assert err == ""
    lines = out.splitlines()
    assert lines[0].startswith("largest payload [kg] of 0 .. 0.4 at which 100% of 2 seeds have")
    assert "tip_rms_error <= 0.01" in lines[0] and "noise:0.4" in lines[1]
    with open(tmp_path / "m.csv", newline="") as file:
        (row,) = csv.DictReader(file)
    report = json.loads((tmp_path / "m.json").read_text())
    (found,) = report["controllers"]
    assert lines[3].split()[:2] == ["smc-boundary", f"{found['margin']:.4g}"]
    assert float(row["margin"]) == found["margin"] == min(found["met"])
    assert 0.05 < found["margin"] < 0.4
    assert all(a < b <= a / 0.98 for a, b in zip(found["met"], found["failed"], strict=True))
    assert report["varied"] == {"name": "payload", "low": 0.0, "high": 0.4, "unit": "kg"}
    assert report["settings"]["bound"] == ["tip_rms_error:0.01"]
    assert {"numpy", "mujoco"} <= set(report["versions"])


def test_the_table_is_honest_about_what_is_not_known(tmp_path, capsys, monkeypatch):
    found = {
        "pd": brackets(-np.inf, -np.inf),
        "smc": brackets(0.5, 0.25),
        "afsmc": brackets(np.inf, np.inf),
    }
    found["smc"].again[1] = True
    alike = dataclasses.replace(found["afsmc"], alike=True)
    answers = iter([found["pd"], found["smc"], alike])
    monkeypatch.setattr(margin_commands, "search", lambda *_: next(answers))
    files = ("--csv", str(tmp_path / "m.csv"), "--json", str(tmp_path / "m.json"))
    assert main(["margin", *found, *GOOD, "--high", "2", "--seeds", "2", *files]) == 0
    lines = capsys.readouterr().out.splitlines()
    rows = [line.split() for line in lines[3:6]]
    assert rows[0] == ["pd", "fails", "?", "..", "fails", "fails", "fails", "fails"]
    assert rows[1] == ["smc", "0.5", "?", "..", "1", "0.5", "0.5", "1", "*"]
    assert rows[2] == ["afsmc", *[">", "2"] * 4]
    notes = "\n".join(lines[6:])
    for words in (
        "> 2: the bound is met there, too",
        "fails: the bound is broken at 0 already",
        "nothing random acts, all seeds are the same",
        "?: 2 seeds have no lower end of a 95 % interval at 90%; it needs 36 seeds",
        "* smc: not so, 1 of 2 seeds meet the bound again further on",
    ):
        assert words in notes
    assert (tmp_path / "m.csv").read_text().splitlines()[1:] == [
        "pd,-inf,,-inf,-inf,-inf,-inf,0,",
        "smc,0.5,,1.0,0.5,0.5,1.0,1,",
        "afsmc,inf,,,inf,inf,inf,0,",
    ]
    last = json.loads((tmp_path / "m.json").read_text())["controllers"][-1]
    assert (last["margin"], last["interval_low"], last["met"]) == ("inf", None, [2.0, 2.0])


def test_several_arms_stand_in_one_table(tmp_path, capsys):
    arms = ("octarm", "fabric")
    words = ["margin", "pd", "smc-boundary", *GOOD, "--seeds", "1"]
    words += ["--settle", "0.2", "--duration", "0.3"]
    files = ["--csv", str(tmp_path / "m.csv"), "--json", str(tmp_path / "m.json")]
    assert main([*words, *(f"--arm={arm}" for arm in arms), *files]) == 0
    out = capsys.readouterr().out
    assert "--arm=octarm --arm=fabric" in out
    report = json.loads((tmp_path / "m.json").read_text())
    assert report["settings"]["arm"] == ["octarm", "fabric"]
    rows = [(row["arm"], row["controller"]) for row in report["controllers"]]
    assert rows == [(arm, name) for arm in arms for name in ("pd", "smc-boundary")]
    with open(tmp_path / "m.csv", newline="") as file:
        assert [(row["arm"], row["controller"]) for row in csv.DictReader(file)] == rows
    (tmp_path / "m.json").unlink()
    assert main([*words, "--arm=fabric", *files[2:]]) == 0  # as it is alone
    alone = json.loads((tmp_path / "m.json").read_text())["controllers"]
    assert alone == report["controllers"][2:]


def test_an_interrupt_ends_it_in_a_sentence(capsys, monkeypatch):
    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(margin_commands, "search", interrupted)
    assert main(["margin", "pd", *GOOD]) == 130
    assert capsys.readouterr().err.startswith("octarm: interrupted")


def test_shares_are_percentages_and_runs_may_begin_elsewhere():
    noise = parse_varied("noise", None, None)
    options = MarginOptions(disturbance=("noise",), bound=("tip_rms_error:0.01",))
    heading = margin_commands._heading(options, noise)
    assert heading[0].startswith("largest noise [%] of 0 .. 500 at which 90% of 36 seeds have")
    assert margin_commands._spelt(0.4, noise) == "40"
    rest, moving = (
        dataclasses.replace(trial("noise", "tip_rms_error:1"), start=start, start_share=0.1)
        for start in ("rest", "moving")
    )
    ends = [runs._begin(np.arange(2), np.zeros(2))[0] for runs in (rest, moving)]
    for environment in ends:
        environment.reset()
    assert not np.any(ends[0].physics.v()) and np.all(ends[1].physics.v())

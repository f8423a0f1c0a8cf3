"""The rules of the verdicts, on numbers that fall on each side of them."""

import math

import numpy as np
import pytest
from paper import adaptation, tracking, writeup
from paper.claims import Row, Verdict, number, span
from paper.evidence import interval
from paper.lyapunov import Outcome
from paper.tables import Table, as_csv
from paper.variants import PROPOSED, all_variants, by_hand, matched_slope

from controllers import make_controller
from octarm.arm.lagrange import equilibrium
from octarm.arm.mjcf import nominal_parameters
from octarm.interfaces import Measurement, Reference
from octarm.reports.statistics import Interval

HOLDS, ONLY_IF, FAILS = Verdict.HOLDS, Verdict.ONLY_IF, Verdict.FAILS


def ratio(value: float, high: float | None = None) -> Interval:
    return Interval(value, value, value if high is None else high)


@pytest.mark.parametrize(
    ("smc", "proposed", "expected"),
    [
        ([2.8, 3.1], [0.1, -0.2], HOLDS),
        ([-7.0, 7.0], [0.1], ONLY_IF),
        ([-7.0, 2.9], [0.1], FAILS),  # never 3 %
        ([-7.0, 7.0], [0.1, -0.6], FAILS),  # not 0 %
        ([2.8], [], FAILS),
    ],
)
def test_overshoot(smc: list[float], proposed: list[float], expected: Verdict):
    assert tracking.overshoot_verdict(smc, proposed) == expected


def test_the_model_error_at_which_the_overshoot_is_that_of_the_paper():
    models = np.array([-0.3, 0.0, 0.3])
    assert tracking.crossing_at(models, np.array([-6.0, 0.0, 6.0])) == pytest.approx(0.15)
    assert math.isnan(tracking.crossing_at(models, np.array([-2.0, 0.0, 2.0])))


@pytest.mark.parametrize(
    ("smc", "ratios", "expected"),
    [
        ([0.8, 2.0], [0.4, 0.5], HOLDS),
        ([0.8, 2.0], [0.4, 0.6], ONLY_IF),
        ([0.05, 2.0], [0.4], FAILS),  # nothing to be seen
        ([0.8, 7.0], [0.4], FAILS),  # not slight
    ],
)
def test_oscillation(smc: list[float], ratios: list[float], expected: Verdict):
    assert tracking.oscillation_verdict(smc, ratios) == expected


@pytest.mark.parametrize(
    ("smooth", "printed", "expected"),
    [
        ([0.04, 0.1], [0.3], HOLDS),
        ([0.04, 0.1], [0.3, 3.0], ONLY_IF),
        ([0.04, 0.6], [0.3], FAILS),
        ([math.inf], [0.3], FAILS),  # the arm is lost
    ],
)
def test_chattering(smooth: list[float], printed: list[float], expected: Verdict):
    assert tracking.chattering_verdict(smooth, printed) == expected


@pytest.mark.parametrize(
    ("noisy", "quiet", "tuned", "expected"),
    [
        ([ratio(0.9)], [ratio(0.9)], [ratio(0.9)], HOLDS),
        ([ratio(0.9)], [ratio(1.0)], [ratio(0.9)], ONLY_IF),
        ([ratio(0.9)], [ratio(0.9)], [ratio(1.1)], ONLY_IF),
        ([ratio(0.9), ratio(0.99)], [ratio(0.9)], [ratio(0.9)], FAILS),
        ([ratio(0.9, high=1.05)], [ratio(0.9)], [ratio(0.9)], FAILS),  # may be chance
        ([ratio(math.nan)], [], [], FAILS),
        ([], [], [], FAILS),
    ],
)
def test_premises(
    noisy: list[Interval], quiet: list[Interval], tuned: list[Interval], expected: Verdict
):
    assert adaptation.premises_verdict(noisy, quiet, tuned) == expected


def outcome(*, outside: int = 0, inside: int = 0, diverged: bool = False) -> Outcome:
    return Outcome(
        label="afsmc", rate=2000.0, mismatch=0.0, covered=True, outside=100,
        grown_outside=outside, inside=5000, grown_inside=inside, start=1.0, bound=0.1,
        diverged=diverged,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("outcomes", "expected"),
    [
        ([outcome(), outcome()], HOLDS),
        ([outcome(), outcome(inside=2000)], ONLY_IF),
        ([outcome(outside=1), outcome()], FAILS),
        ([outcome(diverged=True)], FAILS),
        ([], FAILS),
    ],
)
def test_stability(outcomes: list[Outcome], expected: Verdict):
    assert adaptation.lyapunov_verdict(outcomes) == expected


@pytest.mark.parametrize(
    ("ratios", "expected"),
    [
        ([ratio(0.9), ratio(0.1)], HOLDS),
        ([ratio(0.9), ratio(0.97)], ONLY_IF),
        ([ratio(0.9, high=1.01), ratio(0.5)], ONLY_IF),
        ([ratio(1.2), ratio(math.nan)], FAILS),
    ],
)
def test_uncertainty(ratios: list[Interval], expected: Verdict):
    assert adaptation.uncertainty_verdict(ratios) == expected


def test_computation():
    assert adaptation.load_verdict(0.01) == HOLDS
    assert adaptation.load_verdict(0.2) == FAILS


def test_intervals_hold_the_median_and_have_no_width_where_nothing_is_random():
    draws = np.random.default_rng(0).normal(5.0, 1.0, 64)
    value, low, high = interval(draws)
    assert low < value < high
    assert interval(np.array([0.3])) == interval(np.full(9, 0.3)) == (0.3, 0.3, 0.3)


def test_numbers_in_words():
    assert [number(x) for x in (0.0, 5.0, 123.4, 0.01234, 1e-7)] == [
        "0", "5", "123", "0.0123", "1.00e-07",
    ]  # fmt: skip
    assert number(math.inf) == "∞"
    assert span([math.nan, 0.5, 0.25, math.inf], "%") == "0.250 to 0.500 %"
    assert str(Row("", Interval(50.0, 25.0, 75.0), "%")) == "50 (25 .. 75) %"


def test_a_table_as_csv():
    rows = (("a<b", Interval(1.0, 0.5, 1.5)), ("c", Interval(math.inf, math.nan, math.nan)))
    table = Table("t", "A table.", ("name", "error [%]"), rows)
    head, first, second = as_csv(table).splitlines()
    assert head == "name,error [%],error [%] low,error [%] high"
    assert first == "a<b,1,0.5,1.5"
    assert second == "c,inf,,"


def test_the_claims_go_between_the_markers():
    claim = {"letter": "a", "quote": "x | y", "verdict": "holds", "condition": "", "headline": "1"}
    written = {"claims": [claim]}
    before = f"# t\n\n{writeup.START}\nearlier\n{writeup.END}\n\nrest\n"
    after = writeup.with_claims(before, written)
    assert after.startswith("# t\n\n") and after.endswith("\n\nrest\n")
    assert "earlier" not in after and "| (a) | “x / y” | **holds** | 1 |" in after
    assert writeup.with_claims(after, written) == after
    for broken in ("none", writeup.START, f"{writeup.END}{writeup.START}", before + before):
        with pytest.raises(ValueError, match="once each"):
            writeup.with_claims(broken, written)


def test_the_matched_slope_is_that_of_the_bounds():
    """As a force: afsmc with all that it learns at its bounds, against smc-boundary."""
    gains = all_variants()[by_hand(PROPOSED)].gains
    nominal = nominal_parameters()
    proposed = make_controller(PROPOSED, nominal, gains)
    matched = make_controller("smc-boundary", nominal, matched_slope(gains))
    state = proposed.initial_state()
    signs = np.sign(np.asarray(gains["alpha0"]))
    learnt = state._replace(
        theta=np.multiply.outer(np.asarray(gains["theta_max"]), signs), E=np.asarray(gains["E_max"])
    )
    q, rest = equilibrium(nominal), np.zeros(nominal.coordinates)

    def force(controller, memory, s: np.ndarray) -> np.ndarray:
        command, _ = controller(memory, Measurement(0.0, q, s), Reference(q, rest, rest))
        return command.signals["switching"]

    small = 1e-6 * np.asarray(gains["phi"])
    np.testing.assert_allclose(
        force(proposed, learnt, small), force(matched, None, small), rtol=1e-5
    )
    reach = np.linspace(0.0, 3.0, 301)[:, None] * np.asarray(gains["phi"])
    extra = [force(proposed, learnt, s) + gains["K_v"] * s for s in reach]
    most = [force(matched, None, s) + gains["K_v"] * s for s in reach]
    np.testing.assert_allclose(np.min(extra, axis=0), np.min(most, axis=0), rtol=1e-3)

"""The rule of the verdicts, and the rules of the claims, on numbers that fall on each side."""

import itertools
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from paper import rules, writeup
from paper.claims import (
    Case,
    Row,
    Verdict,
    condition,
    exact,
    matching,
    number,
    numbers_of,
    passed,
    sensitivity,
    span,
    verdict,
)  # fmt: skip
from paper.evidence import Evidence, interval
from paper.plants import longest
from paper.runs import Cost, Descent, Series
from paper.studies import BENDS, FULL, MODELS, NOISE, SLIDES, Cell
from paper.tables import Table, as_csv, best, grid, plants, plants_ranking
from paper.variants import (
    AS_PRINTED,
    FIXED_PREMISES,
    FIXED_RULES,
    PROPOSED,
    SIGN,
    SMC,
    all_variants,
    by_hand,
    matched_slope,
)

from controllers import make_controller
from octarm.arm.lagrange import equilibrium
from octarm.arm.mjcf import nominal_parameters
from octarm.interfaces import Measurement, Reference
from octarm.reports.statistics import Interval

HOLDS, ONLY_IF, FAILS = Verdict.HOLDS, Verdict.ONLY_IF, Verdict.FAILS

RULES = {rule.__name__: rule for rule in (*rules.CLAIMS, *rules.QUESTIONS)}


def case(value: float, limit: float = 1.0, **where: str) -> Case:
    """A case that passes while a value is at most a limit times the factor."""
    row = Row("value", Interval(value, value, value))
    return Case(where, [row], value / limit)


@pytest.mark.parametrize(
    ("values", "expected"),
    [([0.5, 0.9], HOLDS), ([0.5, 2.0], ONLY_IF), ([2.0, 3.0], FAILS), ([], FAILS)],
)
def test_a_claim_holds_in_all_cases_in_some_or_in_none(values: list[float], expected: Verdict):
    assert verdict([case(value) for value in values]) == expected


def test_a_verdict_is_tried_with_half_and_twice_the_threshold_and_each_gain_set():
    cases = [case(0.8, gains="tuned"), case(0.8, gains="hand-set")]
    assert sensitivity(cases) == (4, 6)  # with half of the threshold it does not hold
    cases = [case(0.1, gains="tuned", joints="bends"), case(9.0, gains="tuned", joints="slides")]
    assert verdict(cases) == ONLY_IF and sensitivity(cases) == (0, 6)
    assert sensitivity([case(9.0, model="exact"), case(9.0, model="-30 %")]) == (3, 3)


def test_the_condition_names_where_a_claim_holds_in_all_cases():
    phrases = {"gains": "gains are {}", "joints": "the {} move"}
    values = {("tuned", "bends"): 0.1, ("tuned", "slides"): 0.1, ("hand-set", "bends"): 2.0,
              ("hand-set", "slides"): 0.1}  # fmt: skip
    cases = [case(x, gains=gains, joints=joints) for (gains, joints), x in values.items()]
    assert condition(cases, phrases) == "gains are tuned or the slides move (3 of 4 cases)"
    cases[1] = case(2.0, gains="tuned", joints="slides")
    assert "gains are tuned and the bends move or" in condition(cases, phrases)
    both = [case(0.1, gains="tuned"), case(3.0, gains="tuned")]
    assert condition(both, phrases) == "the cases are picked (1 of 2 cases)"
    assert numbers_of(cases)[0].name == "value (tuned, bends)"
    assert len(matching(cases, {"gains": "tuned"})) == 2


def ratio(value: float, high: float | None = None) -> Interval:
    return Interval(value, value, value if high is None else high)


@pytest.mark.parametrize(
    ("own", "factor", "expected"),
    [
        (ratio(0.94), 1.0, True),
        (ratio(0.96), 1.0, False),
        (ratio(0.96), 0.5, True),
        (ratio(0.94), 2.0, False),
        (ratio(0.9, high=1.05), 1.0, False),  # may be chance
        (ratio(math.nan), 1.0, False),
        (ratio(math.inf), 1.0, False),
        (ratio(0.0), 1.0, True),  # the other one is lost
    ],
)
def test_better_is_by_a_share_and_not_by_chance(own: Interval, factor: float, expected: bool):
    assert (factor <= rules.how_often(own, 0.05)) is expected


LABELS = [
    label
    for name in (PROPOSED, SIGN, SMC, FIXED_RULES, FIXED_PREMISES, AS_PRINTED)
    for label in (name, by_hand(name))
]


def evidence(change: Any = None, **more: Any) -> Evidence:
    """Two episodes a cell of all labels in which every quantity is 1, but for what is changed.

    `change` gives a factor for a cell and a quantity.
    """
    cells = [
        Cell(label, study, reference, model, noise)
        for label in LABELS
        for study, noises in (("tracking", (0.0, NOISE)), ("beyond", (0.0,)))
        for reference, model, noise in itertools.product((BENDS, SLIDES), MODELS, noises)
    ]
    cells += [
        cell._replace(**{name: value})
        for cell in cells
        if cell.study == "beyond"
        for name, sizes in rules.BEYOND.items()
        for value in sizes.values()
    ]
    cells += [
        Cell(label, "plants", noise=noise, plant=modules, rate=rate)
        for label in (PROPOSED, SIGN, SMC)
        for rate, noise, modules in itertools.product(FULL.plant_rates, (0.0, NOISE), FULL.plants)
    ]
    names = ["error", "chattering", *(f"overshoot_{j}" for j in ("theta1", "theta2", "s1", "s2"))]
    measured = {
        cell: {n: np.repeat(1.0 if change is None else change(cell, n), 2) for n in names}
        for cell in cells
    }
    for own in measured.values():
        own["diverged"] = np.isinf(own["error"])
    fields: dict[str, Any] = {
        "variants": {}, "effort": FULL, "series": {}, "outcomes": [], "periods": {},
        "costs": {PROPOSED: Cost(1e-6, 9e-5), SMC: Cost(5e-7, 4e-5)}, **more,
    }  # fmt: skip
    return Evidence(cells=measured, **fields)


def judged(name: str, own: Evidence) -> Verdict:
    return verdict(list(RULES[name](own)))


def of(cell: Cell, *names: str) -> bool:
    """Whether a cell is one of these laws, with either gain set."""
    return cell.label.removesuffix(by_hand("")) in names


@pytest.mark.parametrize(
    ("ours", "theirs", "expected"),
    [(0.1, 3.1, HOLDS), (-0.2, 2.6, HOLDS), (0.6, 3.0, FAILS), (0.1, 5.0, FAILS)],
)
def test_overshoot(ours: float, theirs: float, expected: Verdict):
    said = evidence(lambda cell, name: ours if of(cell, PROPOSED) else theirs)
    assert judged("overshoot", said) == expected


def test_hand_set_gains_count_for_both_sides():
    """The proposed controller is not spared the gains that SMC is judged with."""

    def change(cell: Cell, name: str) -> float:
        return (120.0 if cell.label == by_hand(PROPOSED) else 0.0) if of(cell, PROPOSED) else 3.0

    cases = list(rules.overshoot(evidence(change)))
    assert verdict(cases) == ONLY_IF
    for gains in ("tuned", "hand-set"):
        own = matching(cases, {"gains": gains})
        assert {tuple(c.where.values())[1:] for c in own} == {
            tuple(c.where.values())[1:] for c in cases
        }
    assert condition(cases, writeup.words()["phrases"]).startswith("gains are tuned (")


@pytest.mark.parametrize("name", ["rules", "premises", "uncertainty", "plants", "chattering"])
def test_every_comparison_has_both_sides_in_the_same_place(name: str):
    for own in RULES[name](evidence()):
        assert len({row.number.value for row in own.rows}) == 1
    places = [tuple(c.where.items()) for c in RULES[name](evidence())]
    assert len(set(places)) == len(places)
    if name != "plants":
        gains = [dict(place)["gains"] for place in places]
        assert gains.count("tuned") == gains.count("hand-set")
        joints = [dict(place)["joints"] for place in places]
        assert joints.count("bends") == joints.count("slides")


@pytest.mark.parametrize(
    ("name", "rival"),
    [("rules", FIXED_RULES), ("premises", FIXED_PREMISES), ("plants", SMC)],
)
def test_an_error_counts_against_its_rivals(name: str, rival: str):
    assert judged(name, evidence()) == FAILS
    assert judged(name, evidence(lambda c, _: 0.5 if of(c, PROPOSED) else 1.0)) == HOLDS
    calm = evidence(lambda c, _: 0.5 if of(c, PROPOSED) and not c.noise else 1.0)
    assert judged(name, calm) == ONLY_IF
    lost = evidence(lambda c, _: math.inf)
    assert judged(name, lost) == FAILS  # where both are lost neither is better


def test_uncertainty_is_held_against_the_law_without_its_estimator_and_both_readings_of_smc():
    cases = list(rules.uncertainty(evidence()))
    assert {c.where["against"] for c in cases} == {
        "the same law without its estimator", "SMC with sgn(s)", "SMC with a boundary layer",
    }  # fmt: skip
    assert {c.where["kind"] for c in cases} == {"a wrong model", "noise", *rules.BEYOND}
    assert "delay 1.5 ms" in {c.where.get("size") for c in cases}


def test_chattering():
    assert judged("chattering", evidence(lambda c, _: 0.1)) == HOLDS
    printed = evidence(lambda c, _: 3.0 if of(c, AS_PRINTED) else 0.1)
    assert judged("chattering", printed) == ONLY_IF
    assert judged("chattering", evidence(lambda c, _: math.inf)) == FAILS


@pytest.mark.parametrize(
    ("smc", "ours", "expected"),
    [(2.0, 0.9, HOLDS), (2.0, 1.5, ONLY_IF), (0.05, 1.0, FAILS), (7.0, 6.0, FAILS)],
)
def test_oscillations(smc: float, ours: float, expected: Verdict):
    def series(moved: float) -> Series:
        models, noise = np.repeat(MODELS, 2), np.tile([0.0, NOISE], 3)
        return Series(
            np.zeros(2), np.array([[-100.0] * 6, [100.0] * 6]), np.empty(0), np.empty(0), models,
            noise, np.empty(0), np.full((6, 6), moved),
        )  # fmt: skip

    effort = SimpleNamespace(readings=(BENDS,))
    own = {rules.name_of(SMC, BENDS): series(smc), rules.name_of(PROPOSED, BENDS): series(ours)}
    assert judged("oscillations", evidence(series=own, effort=effort)) == expected


def outcome(*, label: str = "afsmc", outside: int = 0, inside: int = 0, lost: bool = False):
    return Descent(
        label=label, reference=BENDS, rate=2000.0, mismatch=0.0, covered=True, outside=100,
        grown_outside=outside, late=0, inside=5000, grown_inside=inside, start=1.0, bound=0.1,
        diverged=lost,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("outcomes", "expected"),
    [
        ([outcome(), outcome()], HOLDS),
        ([outcome(), outcome(inside=2000)], ONLY_IF),
        ([outcome(outside=1, inside=2000)], FAILS),
        ([outcome(lost=True)], FAILS),
        ([outcome()._replace(rate=500.0)], FAILS),  # none at the default rate
        ([], FAILS),
    ],
)
def test_stability(outcomes: list[Descent], expected: Verdict):
    assert judged("stability", evidence(outcomes=outcomes)) == expected


def test_the_load_of_one_arm_and_of_an_arm_of_a_batch_are_two_numbers():
    cases = list(rules.load(evidence()))
    assert [passed([c]) for c in cases] == [0, 1]  # 18 % and 0.2 % of the period
    assert verdict(cases) == ONLY_IF
    assert condition(cases, writeup.words()["phrases"]).startswith("it is an arm of 1024 (1 of 2")


def test_the_best_law_is_named_whatever_it_is():
    rows = list(best(evidence(lambda c, _: 0.25 if c.label == SIGN else 0.5)))
    assert len(rows) == 12
    assert {row[3] for row in rows} == {SIGN}
    assert all(row[5] == Interval(2.0, 2.0, 2.0) for row in rows)


def test_a_grid_has_a_row_for_each_place_in_which_all_was_run():
    """Its values are ratios to a law in the same place, here twice and half of `afsmc`."""
    factors = {FIXED_RULES: 2.0, SMC: 0.5}
    rows: list[Any] = list(grid(evidence(lambda c, _: factors.get(c.label, 1.0)), "ablations"))
    places = [row[:3] for row in rows]
    assert places[:4] == [
        (SMC, joints, noise)
        for joints in ("theta1, theta2", "s1, s2")
        for noise in ("40 %", "none")
    ]
    assert len(rows) == 4 * 4  # of the laws in that table, four were run
    values = {row[0]: {x.value for x in row[3:]} for row in rows}
    assert values[SMC] == {0.5} and values[FIXED_RULES] == {2.0} and values[AS_PRINTED] == {1.0}
    own = evidence(lambda c, _: 3.0 if c.label == by_hand(SMC) else 1.0)
    others: list[Any] = list(grid(own, "gain-sets"))
    assert {row[0]: row[2].value for row in others} == {
        SIGN: 1.0, SMC: pytest.approx(1.0 / 3.0), PROPOSED: 1.0,
    }  # fmt: skip


def test_a_cell_names_its_study_and_evidence_what_was_varied():
    cells = (Cell(SMC), Cell(SMC, rate=500.0), Cell(SMC, time=0.1), Cell(SMC, "plants", rate=1e4))
    assert [c.title for c in cells] == ["tracking", "rate-500", "correlation", "plants-10000"]
    own = evidence()
    assert own.varied(Cell(""), "mismatch") == [-0.3, 0.0, 0.3]
    assert own.varied(Cell("", "beyond", mismatch=-0.3), "loss") == [0.0, 0.1, 0.3, 0.5]
    assert own.varied(Cell("", mismatch=0.2), "noise") == []


def test_plants_have_a_row_for_each_number_of_modules_period_and_noise():
    def change(cell: Cell, _: str) -> float:
        lost = cell.label != PROPOSED and cell.plant > 9
        return math.inf if lost else 0.01 * cell.plant

    own = evidence(change)
    columns, *table = plants(own)
    assert [row[0] for row in table] == [3, 9, 15, 30] * 4
    by_modules: dict[Any, dict[Any, Any]] = {
        row[0]: dict(zip(columns, row, strict=True)) for row in table
    }
    assert by_modules[30]["best"] == PROPOSED
    assert by_modules[30]["afsmc over smc"] == Interval(0.0, 0.0, 0.0)
    assert by_modules[9]["afsmc over smc"] == Interval(1.0, 1.0, 1.0)
    assert by_modules[30]["rank of smc"] == "lost"
    assert by_modules[30]["rank of afsmc"] == Interval(1.0, 1.0, 1.0)
    heads = ("modules", "period", "noise", "rank", "law", "error", "lost")
    rows = [dict(zip(heads, row, strict=True)) for row in plants_ranking(own)]
    assert len(rows) == 3 * 16
    assert [row["law"] for row in rows if row["modules"] == 30][::3] == [PROPOSED] * 4


def test_a_rank_counts_those_that_are_better_and_its_interval_those_that_may_be():
    """Three laws: the second is 1 % behind the first in one seed and ahead in the other."""
    own = evidence(lambda c, _: {PROPOSED: 1.0, SIGN: 1.01, SMC: 2.0}.get(c.label, 9.0))
    cell = Cell(PROPOSED, "plants", noise=NOISE, plant=9)
    laws = cell.of([PROPOSED, SIGN, SMC])
    assert own.rank(cell, laws) == Interval(1.0, 1.0, 1.0)
    sign = cell._replace(label=SIGN)
    own.cells[sign]["error"][:] = [1.01, 0.98]
    assert own.rank(sign, laws) == Interval(1.0, 1.0, 2.0)
    assert own.rank(cell, laws) == Interval(2.0, 1.0, 2.0)
    assert own.rank(cell._replace(label=SMC), laws) == Interval(3.0, 3.0, 3.0)


@pytest.mark.parametrize("limit", [0.3, 0.9, 1.0, 1.7, 7.0])
def test_the_longest_period_is_bracketed_and_bisected(limit: float):
    found = longest(lambda period: period <= 1e-3 * limit, 1e-3)
    assert limit / 1.05 <= 1e3 * found <= limit


def test_a_period_outside_those_that_are_looked_at_is_none():
    assert longest(lambda period: True, 1e-3) == math.inf
    assert longest(lambda period: False, 1e-3) == 0.0


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
    rows = [exact("", x) for x in (math.nan, 0.5, 0.25, math.inf)]
    assert span(rows, "%") == "0.250 to 0.500 %" and span(rows[:1]) == "unknown"
    assert str(Row("", Interval(50.0, 25.0, 75.0), "%")) == "50 (25 .. 75) %"


def test_a_table_as_csv():
    rows = (("a<b", Interval(1.0, 0.5, 1.5)), ("c", Interval(math.inf, math.nan, math.nan)))
    table = Table("t", "A table.", ("name", "error [%]"), rows)
    head, first, second = as_csv(table).splitlines()
    assert head == "name,error [%],error [%] low,error [%] high"
    assert first == "a<b,1,0.5,1.5"
    assert second == "c,inf,,"


def test_the_claims_go_between_the_markers():
    claim = {"letter": "a", "quote": "x | y", "place": "p", "verdict": "holds", "condition": "",
             "stays": "5 of 6", "headline": "1"}  # fmt: skip
    written = {"claims": [claim], "questions": [], "best": [], "plants": [], "periods": []}
    before = f"# t\n\n{writeup.START}\nearlier\n{writeup.END}\n\nrest\n"
    after = writeup.with_claims(before, written)
    assert after.startswith("# t\n\n") and after.endswith("\n\nrest\n")
    assert "earlier" not in after and "| (a) | “x / y” | **holds** | 5 of 6 | 1 |" in after
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

"""The fuzzy engine against scikit-fuzzy, against closed forms, and against its own promises."""

import dataclasses
import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
import skfuzzy
from hypothesis import given, settings
from hypothesis import strategies as st

from controllers.fuzzy.inference import Mamdani, Sugeno, Variable, linear, probabilistic_sum
from controllers.fuzzy.membership import Gaussian, GeneralisedBell, Trapezoidal, Triangular
from controllers.fuzzy.rule_base import RuleBase
from controllers.fuzzy_rules import LEVELS, RULES, SURFACE

FAMILIES = [Triangular, Trapezoidal, GeneralisedBell, Gaussian]
LABELS = tuple(LEVELS)
E, RATE = (Variable.uniform(name, LABELS) for name in ("e", "rate"))
# Sets that end within the universe, so that the strongest rule alone gives exactly +-1.
PEAKS = np.linspace(-1.0, 1.0, 7).tolist()
THIRD = 1 / 3
CLOSED = Variable("u", {n: Triangular(p - THIRD, p, p + THIRD) for n, p in LEVELS.items()})
UNIVERSE = np.linspace(-4 * THIRD, 4 * THIRD, 161)
ANYTHING = st.floats(allow_nan=False)  # also infinite, denormal, 1e308


def seven_by_seven(**changes) -> Mamdani:
    given = {"inputs": (E, RATE), "output": CLOSED, "rules": RULES, "universe": UNIVERSE}
    return Mamdani(**(given | changes))


def random_rules(seed: int) -> RuleBase:
    conclusions = np.random.default_rng(seed).choice(LABELS, size=(7, 7))
    rows = (" ".join([label, *row]) for label, row in zip(LABELS, conclusions, strict=True))
    return RuleBase.from_table("\n".join(["e / rate " + " ".join(LABELS), *rows]))


def random_inputs(n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    x, y = np.random.default_rng(seed).uniform(-1.5, 1.5, size=(2, n))
    return x, y


# Inference against scikit-fuzzy


def their_grades(x: np.ndarray) -> dict[str, np.ndarray]:
    """The memberships of E and RATE from scikit-fuzzy, whose shoulders end far out."""
    ends = [-1e6, *PEAKS, 1e6]
    shapes = {n: [ends[i], p, p, ends[i + 2]] for i, (n, p) in enumerate(LEVELS.items())}
    shapes["NB"][1], shapes["PB"][2] = -1e6, 1e6
    return {label: skfuzzy.trapmf(x, corners) for label, corners in shapes.items()}


def their_weights(rules: RuleBase, x, y, conjunction) -> list[np.ndarray]:
    grades = {"e": their_grades(x), "rate": their_grades(y)}
    return [conjunction(*(grades[name][label] for name, label in rule.cases[0])) for rule in rules]


def their_sets(rules, x, y, conjunction, implication, output) -> np.ndarray:
    """The implied set of each rule on the universe, shape (rules, samples, n)."""
    weights = their_weights(rules, x, y, conjunction)
    return np.stack(
        [
            implication(w[:, None], output[rule.conclusion])
            for rule, w in zip(rules, weights, strict=True)
        ]
    )


def their_centroid(universe: np.ndarray, sets: np.ndarray) -> np.ndarray:
    return np.array([skfuzzy.defuzz(universe, mu, "centroid") for mu in sets], dtype=float)


@pytest.mark.parametrize("conjunction", [np.fmin, np.multiply])
@pytest.mark.parametrize("implication", [np.fmin, np.multiply])
@pytest.mark.parametrize("aggregation", [np.maximum, np.add])
@pytest.mark.parametrize("closed", [True, False])
def test_mamdani_is_scikit_fuzzy_and_the_printed_sum(conjunction, implication, aggregation, closed):
    rules, (x, y) = random_rules(1), random_inputs(100)
    universe = np.linspace(-1.5, 1.5, 301)
    if closed:
        output = CLOSED
        grades = {n: skfuzzy.trimf(universe, [p - THIRD, p, p + THIRD]) for n, p in LEVELS.items()}
    else:
        output, grades = Variable.uniform("u", LABELS), their_grades(universe)
    ours = seven_by_seven(
        rules=rules,
        output=output,
        universe=universe,
        conjunction=np.minimum if conjunction is np.fmin else np.multiply,
        implication=np.minimum if implication is np.fmin else np.multiply,
        aggregation=aggregation,
    )
    sets = their_sets(rules, x, y, conjunction, implication, grades)
    whole = sets.max(axis=0) if aggregation is np.maximum else sets.sum(axis=0)
    printed = whole @ universe / whole.sum(axis=-1)  # (50)
    np.testing.assert_allclose(ours(x, y), printed, rtol=0.0, atol=1e-6 * 3.0)
    gravity = sets.sum(axis=0) @ universe / sets.sum(axis=(0, 2))  # (49)
    np.testing.assert_allclose(ours.cog(x, y), gravity, rtol=0.0, atol=1e-6 * 3.0)
    if closed:  # their centroid is an integral: it is the sum when the sets end in the universe
        centroid = their_centroid(universe, whole)
        np.testing.assert_allclose(ours(x, y), centroid, rtol=0.0, atol=1e-6 * 3.0)


def test_the_printed_sum_tends_to_the_centroid_of_scikit_fuzzy():
    """With open shoulders the sum counts the ends of the universe in full, an error of O(1/n)."""
    rules, (x, y) = random_rules(2), random_inputs(20)
    errors = []
    for n in (501, 1001):
        universe = np.linspace(-1.0, 1.0, n)
        ours = seven_by_seven(rules=rules, output=Variable.uniform("u", LABELS), universe=universe)
        whole = their_sets(rules, x, y, np.fmin, np.fmin, their_grades(universe)).max(axis=0)
        centroid = their_centroid(universe, whole)
        errors.append(np.max(np.abs(ours(x, y) - centroid)))
    assert errors[1] == pytest.approx(0.5 * errors[0], rel=0.05)
    assert errors[1] < 2.0 * 0.002  # steps of the universe


@pytest.mark.parametrize("conjunction", [np.minimum, np.multiply])
def test_sugeno_is_the_weighted_mean_of_scikit_fuzzys_weights(conjunction):
    rules, (x, y) = random_rules(3), random_inputs(500)
    draw = np.random.default_rng(4).normal(size=(7, 3))
    planes = {n: linear(c, a, b) for n, (c, a, b) in zip(LABELS, draw, strict=True)}
    weights = np.stack(their_weights(rules, x, y, conjunction))
    z = {n: c + a * x + b * y for n, (c, a, b) in zip(LABELS, draw, strict=True)}
    for consequents, values in ((planes, z), (LEVELS, LEVELS)):
        ours = Sugeno(
            inputs=(E, RATE), rules=rules, consequents=consequents, conjunction=conjunction
        )
        each = np.stack([values[r.conclusion] * np.ones_like(x) for r in rules])
        theirs = np.sum(weights * each, axis=0) / np.sum(weights, axis=0)
        np.testing.assert_allclose(ours(x, y), theirs, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("disjunction", "theirs"),
    [(np.maximum, np.fmax), (probabilistic_sum, lambda a, b: 1.0 - (1.0 - a) * (1.0 - b))],
)
def test_or_joins_cases(disjunction, theirs):
    rules = RuleBase.from_sentences(
        "if a is N and b is N or c is P then low\nif a is P or b is P or c is N then high"
    )
    inputs = tuple(Variable.uniform(name, "N P") for name in "abc")
    ours = Sugeno(
        inputs=inputs,
        rules=rules,
        consequents={"low": 2.0, "high": 5.0},
        conjunction=np.minimum,
        disjunction=disjunction,
    )
    a, b, c = x = np.random.default_rng(5).uniform(-1.0, 1.0, size=(3, 200))
    (an, bn, cn), (ap, bp, cp) = (1.0 - x) / 2.0, (1.0 + x) / 2.0
    low, high = theirs(np.fmin(an, bn), cp), theirs(theirs(ap, bp), cn)
    np.testing.assert_allclose(ours(a, b, c), (2 * low + 5 * high) / (low + high), atol=1e-12)


# Closed forms


def test_three_sets_by_hand():
    """Rules N -> N and P -> P at x = 0.5: N holds to 1/4, P to 3/4."""
    sides = {"N": Triangular(-2.0, -1.0, 0.0), "P": Triangular(0.0, 1.0, 2.0)}
    system = Mamdani(
        inputs=(Variable.uniform("x", "N P"),),
        output=Variable("u", sides),
        rules=RuleBase.from_sentences("if x is N then N\nif x is P then P"),
        universe=np.array([-1.5, -1.0, 0.0, 1.0, 1.5]),  # memberships 1/2, 1, 0, 1, 1/2
    )
    above = -1.5 * 0.25 - 1.0 * 0.25 + 1.0 * 0.75 + 1.5 * 0.5
    assert system(np.array(0.5)) == pytest.approx(above / 1.75, abs=1e-15)
    product = dataclasses.replace(system, implication=np.multiply)
    assert product(np.array(0.5)) == pytest.approx(0.5 * 1.75 / 1.5, abs=1e-15)


def test_one_input_interpolates_between_its_consequents():
    values = dict(zip(LABELS, [-3.0, 1.0, 0.5, 0.0, 2.0, 2.5, -1.0], strict=True))
    rules = RuleBase.from_sentences("\n".join(f"if e is {n} then {n}" for n in LABELS))
    system = Sugeno(inputs=(E,), rules=rules, consequents=values)
    x = np.linspace(-2.0, 2.0, 997)
    np.testing.assert_allclose(system(x), np.interp(x, PEAKS, list(values.values())), atol=1e-12)


def test_cog_is_coa_under_sum_min_and_differs_under_max_min():
    x, y = random_inputs(200)
    summed, largest = seven_by_seven(aggregation=np.add), seven_by_seven()
    np.testing.assert_array_equal(summed.cog(x, y), summed.coa(x, y))
    np.testing.assert_array_equal(summed.cog(x, y), largest.cog(x, y))
    assert np.max(np.abs(largest.cog(x, y) - largest.coa(x, y))) > 0.02


# Promises


def systems() -> dict[str, Sugeno | Mamdani]:
    out: dict[str, Sugeno | Mamdani] = {"recommended": SURFACE}
    for family, norm in itertools.product(FAMILIES, (np.minimum, np.multiply)):
        inputs = tuple(Variable.uniform(n, LABELS, family=family) for n in ("e", "rate"))
        name = f"{family.__name__} {norm.__name__}"
        out[f"sugeno {name}"] = Sugeno(
            inputs=inputs, rules=RULES, consequents=LEVELS, conjunction=norm
        )
        out[f"mamdani {name}"] = seven_by_seven(
            inputs=inputs, conjunction=norm, implication=norm, universe=UNIVERSE[::8]
        )
    return out


SYSTEMS = systems()


@pytest.mark.parametrize("name", SYSTEMS)
@settings(max_examples=40)
@given(ANYTHING, ANYTHING)
def test_every_input_has_an_output_within_the_range(name, x, y):
    """Within the range, outside, at infinity: no hole, no NaN."""
    assert abs(SYSTEMS[name](np.asarray(x), np.asarray(y))) <= 1.0 + 1e-12


@pytest.mark.parametrize("name", SYSTEMS)
@given(x=st.floats(-1.5, 1.5), y=st.floats(-1.5, 1.5))
@settings(max_examples=20)
def test_the_surface_is_odd(name, x, y):
    system, at, mirrored = SYSTEMS[name], (np.asarray(x), np.asarray(y)), (-x, -y)
    np.testing.assert_allclose(system(*at), -system(*map(np.asarray, mirrored)), atol=1e-12)


@pytest.mark.parametrize("name", SYSTEMS)
def test_one_input_pair_equals_its_place_in_a_batch_bit_for_bit(name):
    x, y = np.random.default_rng(6).uniform(-1.5, 1.5, size=(2, 17, 6))
    whole = SYSTEMS[name](x, y)
    np.testing.assert_array_equal(whole, SYSTEMS[name](*map(np.asfortranarray, (x, y))))
    np.testing.assert_array_equal(whole[3], SYSTEMS[name](x[3], y[3]))
    assert whole[3, 4] == SYSTEMS[name](x[3, 4], y[3, 4])
    np.testing.assert_array_equal(whole[3, 4], SYSTEMS[name](x[:, 4:5], y[3:4])[3, 4])


def test_not_a_number_is_not_hidden():
    x = np.array([0.1, np.nan])
    for name, system in SYSTEMS.items():
        assert np.array_equal(np.isnan(system(x, x[::-1])), [True, True]), name
        assert np.array_equal(np.isnan(system(x, 0.0 * x[:1])), [False, True]), name


@pytest.mark.parametrize(
    ("name", "dip"),
    [
        ("recommended", 0.0),
        ("sugeno Triangular minimum", 0.0),
        ("mamdani Triangular multiply", 0.0),
        ("sugeno Gaussian multiply", 0.0),
        # Clipped sets of unlike widths pull the centre back a little where two rules tie.
        ("mamdani Triangular minimum", 0.01),
    ],
)
def test_the_surface_rises_with_both_inputs(name, dip):
    grid = np.linspace(-1.2, 1.2, 193)
    surface = SYSTEMS[name](grid[:, None], grid)
    for axis in (0, 1):
        assert -dip - 1e-12 <= np.min(np.diff(surface, axis=axis)) <= 1e-12 - 0.1 * dip


def test_the_recommended_surface_saturates():
    far = np.array([1.0, 1.5, 1e9, np.inf])
    np.testing.assert_allclose(SURFACE(far, np.zeros(4)), 1.0)
    np.testing.assert_allclose(SURFACE(np.zeros(4), far), 1.0)
    np.testing.assert_allclose(SURFACE(far, -far), 0.0, atol=1e-12)


def test_the_recommended_surface_is_a_plane_near_zero():
    x, y = random_inputs(2000)
    small = np.abs(x) + np.abs(y) <= 2 / 3
    np.testing.assert_allclose(SURFACE(x, y)[small], (x + y)[small], atol=1e-12)
    assert np.sum(small) > 100


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Sugeno(
                inputs=(Variable("e", {"N": Triangular(-2, -1, 0), "P": Triangular(0, 1, 2)}),),
                rules=RuleBase.from_sentences("if e is N then N\nif e is P then N"),
                consequents={"N": 0.0},
            ),
            r"e = -inf belongs to no label; known are N, P, which must overlap and be open",
        ),
        (
            lambda: Sugeno(
                inputs=(
                    Variable(
                        "e",
                        {"N": Gaussian(-1, math.inf, 0.1), "P": Gaussian(1, 0.1, math.inf)},
                    ),
                ),
                rules=RuleBase.from_sentences("if e is N then N\nif e is P then N"),
                consequents={"N": 0.0},
            ),
            r"e = -0\.\d+ belongs to no label",
        ),
        (lambda: seven_by_seven(inputs=(E, E)), "two inputs are called 'e'; they need different"),
        (
            lambda: seven_by_seven(universe=[0.0, 0.1]),
            "no element of the universe, from 0 to 0.1",
        ),
        (lambda: seven_by_seven(universe=1.0), r"universe has shape \(\); it must be \(n,\)"),
        (lambda: seven_by_seven(universe=[math.nan]), "universe holds nan; it must be finite"),
        (lambda: seven_by_seven()(np.zeros(3)), "1 inputs are given; the rules need e, rate"),
    ],
)
def test_systems_that_do_not_fit_together_are_refused(make: Callable, message: str):
    with pytest.raises(ValueError, match=message):
        make()

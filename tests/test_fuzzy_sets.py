"""Fuzzy sets, linguistic variables and rule bases."""

import math
from collections.abc import Callable

import numpy as np
import pytest
import skfuzzy
from hypothesis import given
from hypothesis import strategies as st

from controllers.fuzzy.inference import Sugeno, Variable
from controllers.fuzzy.membership import Gaussian, GeneralisedBell, Trapezoidal, Triangular
from controllers.fuzzy.rule_base import RuleBase
from controllers.fuzzy_rules import RULES

FAMILIES = [Triangular, Trapezoidal, GeneralisedBell, Gaussian]
ANYTHING = st.floats(allow_nan=False)  # also infinite, denormal, 1e308


# Membership functions


@pytest.mark.parametrize(
    ("ours", "theirs"),
    [
        (Triangular(-0.3, 0.1, 0.9), lambda x: skfuzzy.trimf(x, [-0.3, 0.1, 0.9])),
        (Triangular(0.1, 0.1, 0.9), lambda x: skfuzzy.trimf(x, [0.1, 0.1, 0.9])),
        (Triangular(-0.3, 0.9, 0.9), lambda x: skfuzzy.trimf(x, [-0.3, 0.9, 0.9])),
        (Trapezoidal(-0.5, -0.2, 0.3, 0.7), lambda x: skfuzzy.trapmf(x, [-0.5, -0.2, 0.3, 0.7])),
        (Trapezoidal(-0.2, -0.2, 0.3, 0.3), lambda x: skfuzzy.trapmf(x, [-0.2, -0.2, 0.3, 0.3])),
        (GeneralisedBell(0.2, 0.3, 0.3, 2.5), lambda x: skfuzzy.gbellmf(x, 0.3, 2.5, 0.2)),
        (Gaussian(0.2, 0.3, 0.3), lambda x: skfuzzy.gaussmf(x, 0.2, 0.3 / math.sqrt(2.0))),
    ],
)
def test_membership_functions_are_those_of_scikit_fuzzy(ours, theirs):
    corners = [-0.5, -0.3, -0.2, 0.1, 0.2, 0.3, 0.7, 0.9]
    x = np.concatenate([np.linspace(-1.0, 1.0, 2001), corners])
    np.testing.assert_allclose(ours(x), theirs(x), rtol=0.0, atol=1e-12)


@pytest.mark.parametrize(
    "membership",
    [
        Triangular(-math.inf, 0.0, 1.0),
        Trapezoidal(-math.inf, -0.5, 0.0, 1.0),
        GeneralisedBell(0.0, math.inf, 1.0),
        Gaussian(0.0, math.inf, 1.0),
    ],
)
def test_an_open_shoulder_stays_at_one(membership):
    left = np.array([-np.inf, -1e308, -1.0, 0.0])
    np.testing.assert_array_equal(membership(left), 1.0)
    right = membership(np.array([0.1, 0.5, 1e308, np.inf]))
    assert 1.0 > right[0] > right[1] > right[2] == right[3] == 0.0
    assert np.isnan(membership(np.array(np.nan)))


@pytest.mark.parametrize("family", FAMILIES)
@given(st.integers(2, 9), st.floats(-50.0, 50.0), st.floats(0.01, 100.0), ANYTHING)
def test_a_uniform_partition_covers_every_number(family, labels, low, width, x):
    variable = Variable.uniform("x", list("abcdefghi"[:labels]), low, low + width, family)
    memberships = np.array(list(variable(np.asarray(x)).values()))
    assert np.all((memberships >= 0.0) & (memberships <= 1.0))
    assert np.max(memberships) >= 0.5 - 1e-9
    assert variable.hole() is None
    if family in (Triangular, Trapezoidal):
        assert np.sum(memberships) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize("family", FAMILIES)
def test_membership_functions_keep_shape_and_bits(family):
    x = np.random.default_rng(0).normal(size=(257, 6))
    membership = family.between(-0.7, 0.1, 0.8)
    whole = membership(x)
    assert whole.shape == x.shape
    np.testing.assert_array_equal(whole, membership(np.asfortranarray(x)))
    np.testing.assert_array_equal(whole, np.stack([membership(row) for row in x]))
    assert whole[3, 4] == membership(x[3, 4])


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Triangular(0.0, -1.0, 1.0),
            "corners of Triangular are 0, -1, -1, 1; they must",
        ),
        (lambda: Triangular(0.0, math.nan, 1.0), "corners of Triangular are 0, nan, nan, 1"),
        (lambda: Triangular(0.0, math.inf, math.inf), "the top of Triangular is infinite"),
        (lambda: Trapezoidal(0, 2, 1, 3), "corners of Trapezoidal are 0, 2, 1, 3; they must rise"),
        (lambda: Trapezoidal(-math.inf, -math.inf, 1, 3), "the top of Trapezoidal is infinite"),
        (lambda: Gaussian(0.0, 0.0, 1.0), "left of Gaussian is 0; it must be above 0"),
        (lambda: Gaussian(math.nan, 1.0, 1.0), "center of Gaussian is nan; it must be finite"),
        (lambda: GeneralisedBell(0.0, 1.0, -1.0), "right of GeneralisedBell is -1; it must be ab"),
        (lambda: GeneralisedBell(0, 1, 1, slope=0), "slope of GeneralisedBell is 0; it must be ab"),
        (lambda: Variable("e", {}), "e has no labels; it needs at least one"),
        (lambda: Variable.uniform("e", "Z"), "e has 1 labels; a uniform one needs at least 2"),
        (lambda: Variable.uniform("e", "N Z N"), "e has the label 'N' more than once"),
        (lambda: Variable.uniform("e", "N P", 1.0, 1.0), "e goes from 1 to 1; low must be below"),
    ],
)
def test_impossible_sets_are_refused_in_one_sentence(make: Callable, message: str):
    with pytest.raises(ValueError, match=message):
        make()


# Rule bases

SMALL = """
    e / rate  N   P    # two labels each
    N         NB  ZE
    P         ZE  PB
"""


def small_system(table: str) -> Sugeno:
    inputs = tuple(Variable.uniform(name, "N P") for name in ("e", "rate"))
    rules = RuleBase.from_table(table)
    return Sugeno(inputs=inputs, rules=rules, consequents={"NB": -1.0, "ZE": 0.0, "PB": 1.0})


def test_a_table_is_its_sentences():
    sentences = """
        if e is N and rate is N then NB
        if e is N and rate is P then ZE   # a comment

        if e is P and rate is N then ZE
        if e is P and rate is P then PB
    """
    assert RuleBase.from_table(SMALL) == RuleBase.from_sentences(sentences)
    assert RuleBase.from_sentences(str(RULES)) == RULES
    assert len(RULES) == 49


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            ("P         ZE  PB", "P  ZE"),
            "row P of the rule table has 1 conclusions; it needs 2, one",
        ),
        (("P         ZE  PB", ""), "no rule is for e is P and rate is N, and 1 other comb"),
        (("P         ZE  PB", "N  ZE PB"), "two rules are for e is N and rate is N, one concludes"),
        (("N   P ", "N   N "), "two rules are for e is N and rate is N"),
        (("P         ZE  PB", "PP ZE PB"), "unknown label 'PP' of e in the rule .*mean 'P'"),
        (("ZE  PB", "ZE  PBB"), "unknown conclusion 'PBB' in the rule .*did you mean 'PB'.*NB, ZE"),
        (("e / rate", "e / rat"), "unknown variable 'rat' in the rule .*did you mean 'rate'"),
        (("e / rate", "e"), "a rule table begins with 'e  N   P'; it needs the variables"),
    ],
)
def test_mistakes_in_a_table_are_told_in_one_sentence(change: tuple[str, str], message: str):
    small_system(SMALL)
    with pytest.raises(ValueError, match=message):
        small_system(SMALL.replace(*change))


@pytest.mark.parametrize(
    "line",
    [
        "e is N then ZE",
        "if e is N and then ZE",
        "if e is N",
        "if e N then ZE",
        "if e is N then u is ZE",
        "if e is very N then ZE",
    ],
)
def test_a_line_that_is_no_rule_is_shown_how_to_write_one(line: str):
    with pytest.raises(ValueError, match=f"the rule '{line}' cannot be read; write it as 'if e"):
        RuleBase.from_sentences(line)


def test_an_empty_rule_base_is_refused():
    with pytest.raises(ValueError, match="has no rules"):
        RuleBase.from_sentences("# nothing yet")
    with pytest.raises(ValueError, match="begins with ''"):
        RuleBase.from_table("")


def test_or_and_short_antecedents_cover_what_they_say():
    inputs = tuple(Variable.uniform(name, "N Z P") for name in ("a", "b"))
    text = "if a is N or b is N and a is P then x\nif a is Z then y\nif b is P and a is P then x"
    rules = RuleBase.from_sentences(text)
    with pytest.raises(ValueError, match=r"no rule is for a is P and b is Z; there must be one"):
        Sugeno(inputs=inputs, rules=rules, consequents={"x": 0.0, "y": 1.0})
    whole = RuleBase.from_sentences(text + "\nif b is Z and a is P then y")
    Sugeno(inputs=inputs, rules=whole, consequents={"x": 0.0, "y": 1.0})

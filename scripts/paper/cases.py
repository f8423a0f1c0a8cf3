"""The one rule of all verdicts: a claim is a condition on numbers that is looked at case by case.

A case is a place in which the condition was measured: a gain set, the joints that move, a nominal
model, and so on. The claim holds if it does in all cases, does not hold if it does in none, and
else holds only if the cases are narrowed down.
"""

import enum
import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple

from paper.numbers import Row


class Verdict(enum.StrEnum):
    """What came of a claim."""

    HOLDS = "holds"
    ONLY_IF = "holds only if"
    FAILS = "does not hold"


# What a verdict is tried with.
FACTORS = (0.5, 1.0, 2.0)  # by which the threshold of a rule is multiplied
SENSITIVE = ("gains", "joints", "SMC", "against")  # axes along which a verdict is looked at apart


class Case(NamedTuple):
    """A place in which a claim was measured."""

    where: Mapping[str, str]  # value of each axis, such as gains, joints and model
    rows: Sequence[Row]  # the numbers
    passes: Callable[[float], bool]  # whether it holds there, by the factor of the threshold


def verdict(cases: Sequence[Case], factor: float = 1.0) -> Verdict:
    """The rule; a claim without a case does not hold."""
    passed = [case.passes(factor) for case in cases]
    if not any(passed):
        return Verdict.FAILS
    return Verdict.HOLDS if all(passed) else Verdict.ONLY_IF


def sensitivity(cases: Sequence[Case]) -> tuple[int, int]:
    """In how many variations the verdict is the same, and how many variations there are.

    A variation is a threshold, halved, as it is or doubled, with the cases of one gain set, one
    reading of the joints and one of the controller it is compared with.
    """
    parts = list(_parts(cases))
    outcomes = [verdict(part, factor) for part in parts for factor in FACTORS]
    return outcomes.count(verdict(cases)), len(outcomes)


def condition(cases: Sequence[Case], phrases: Mapping[str, str]) -> str:
    """Where a claim holds in every case, in words, and in how many of all cases it does.

    Args:
        cases: all of them.
        phrases: a text for each axis, with {} for its value.
    """
    count = sum(case.passes(1.0) for case in cases)
    one, two = (list(_sufficient(cases, axes)) for axes in (1, 2))
    names = [" and ".join(phrases[x].format(value) for x, value in own) for own in one or two]
    words = " or ".join(names[:2]) if names else "the cases are picked"
    return f"{words} ({count} of {len(cases)} cases)"


def numbers_of(cases: Sequence[Case]) -> list[Row]:
    """The rows of all cases, each with its place in its name."""
    return [
        row._replace(name=f"{row.name} ({', '.join(case.where.values())})")
        for case in cases
        for row in case.rows
    ]


def matching(cases: Sequence[Case], where: Mapping[str, str]) -> list[Case]:
    """The cases at these values of axes."""
    return [case for case in cases if where.items() <= case.where.items()]


def _sufficient(cases: Sequence[Case], axes: int) -> Iterator[tuple[tuple[str, str], ...]]:
    """The values of one axis, or of two, for which the claim holds in all cases."""
    pairs = dict.fromkeys(pair for case in cases for pair in case.where.items())
    dividing = [pair for pair in pairs if len(matching(cases, dict([pair]))) < len(cases)]
    for own in itertools.combinations(dividing, axes):
        where = dict(own)
        if len(where) == axes and verdict(matching(cases, where)) == Verdict.HOLDS:
            yield own


def _parts(cases: Sequence[Case]) -> Iterator[list[Case]]:
    """The cases of each combination of values of the axes that are looked at apart."""
    keys = [tuple(case.where.get(axis) for axis in SENSITIVE) for case in cases]
    for key in dict.fromkeys(keys):
        yield [case for case, own in zip(cases, keys, strict=True) if own == key]

"""Fuzzy rules as data that a person can read and edit, eqs (44)-(46).

Rules are written as sentences, one a line, in which AND binds tighter than OR,

    if e is NB and rate is NB then NB
    if e is PB or rate is PB then PB

or, for two inputs, as a table: rows are labels of the first input, columns of the second one.

    e / rate  N   Z   P
    N         NB  NS  ZE
    Z         NS  ZE  PS
    P         ZE  PS  PB

Empty lines, and what follows a #, do not count.
"""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterable, Mapping
from typing import NamedTuple

from octarm.errors import OctarmError, closest, quoted

Clause = tuple[str, str]  # a variable and its label


class Rule(NamedTuple):
    """If all clauses of at least one case hold, then the conclusion.

    Attributes:
        cases: joined by OR; the clauses of each are joined by AND.
        conclusion: label of the consequent.
    """

    cases: tuple[tuple[Clause, ...], ...]
    conclusion: str

    def __str__(self) -> str:
        return f"if {' or '.join(map(_words, self.cases))} then {self.conclusion}"


class RuleBase(tuple[Rule, ...]):
    """Rules in the order in which they were written.

    Raises OctarmError if there are no rules, or two of them share a case.
    """

    def __init__(self, rules: Iterable[Rule] = (), /) -> None:
        del rules  # which the tuple holds already
        if not self:
            raise OctarmError("a rule base has no rules; it needs at least one")
        seen: dict[frozenset[Clause], str] = {}
        for rule in self:
            for case in rule.cases:
                if frozenset(case) in seen:
                    raise OctarmError(
                        f"two rules are for {_words(case)}, one concludes {seen[frozenset(case)]} "
                        f"and the other {rule.conclusion}; there may be only one"
                    )
                seen[frozenset(case)] = rule.conclusion

    def __str__(self) -> str:
        return "\n".join(map(str, self))

    @classmethod
    def from_sentences(cls, text: str) -> RuleBase:
        """Reads one rule a line, such as `if e is NB and rate is PS then NM`.

        Raises OctarmError for a line that is not such a sentence, or two rules for one case.
        """
        return cls(_sentence(line) for line in _lines(text))

    @classmethod
    def from_table(cls, text: str) -> RuleBase:
        """Reads a table whose first line is `row variable / column variable` and column labels.

        Raises OctarmError for another first line, or a row that is too short or too long.
        """
        first, *lines = _lines(text) or [""]
        head = re.fullmatch(r"(\S+)\s*/\s*(\S+)\s+(.+)", first)
        if not head:
            raise OctarmError(
                f"a rule table begins with {quoted(first)}; it needs the variables and the "
                "labels of the columns, as in 'e / rate  N Z P'"
            )
        row_variable, column_variable, columns = head[1], head[2], head[3].split()
        rules: list[Rule] = []
        for row, *conclusions in map(str.split, lines):
            if len(conclusions) != len(columns):
                raise OctarmError(
                    f"row {row} of the rule table has {len(conclusions)} conclusions; it needs "
                    f"{len(columns)}, one for each label of {column_variable}"
                )
            for column, conclusion in zip(columns, conclusions, strict=True):
                rules.append(Rule((((row_variable, row), (column_variable, column)),), conclusion))
        return cls(rules)

    def check(self, inputs: Mapping[str, Iterable[str]], conclusions: Iterable[str]) -> None:
        """Checks that the rules use known words and leave no combination of labels out.

        Inputs are given with their labels. Raises OctarmError for an unknown variable or label, or
        a combination without a rule.
        """
        for rule in self:
            for variable, label in itertools.chain(*rule.cases):
                _check_known(f"variable {quoted(variable)}", rule, variable, inputs)
                _check_known(f"label {quoted(label)} of {variable}", rule, label, inputs[variable])
            word = rule.conclusion
            _check_known(f"conclusion {quoted(word)}", rule, word, conclusions)
        cases = [frozenset(case) for rule in self for case in rule.cases]
        clauses = ([(name, label) for label in labels] for name, labels in inputs.items())
        combinations = itertools.product(*clauses)
        missing = [x for x in combinations if not any(case <= {*x} for case in cases)]
        if missing:
            more = f", and {len(missing) - 1} other combinations" if missing[1:] else ""
            raise OctarmError(f"no rule is for {_words(missing[0])}{more}; there must be one")


def _lines(text: str) -> list[str]:
    lines = (line.partition("#")[0].strip() for line in text.splitlines())
    return [line for line in lines if line]


def _sentence(line: str) -> Rule:
    """One rule; OR separates its cases, AND the clauses of a case."""
    parts = re.fullmatch(r"if\s+(.+)\s+then\s+(\S+)", line)
    cases = re.split(r"\s+or\s+", parts[1]) if parts else []
    words = [[x.split() for x in re.split(r"\s+and\s+", case)] for case in cases]
    if not parts or any(len(x) != 3 or x[1] != "is" for x in itertools.chain(*words)):
        example = "if e is NB and rate is PS then NM"
        raise OctarmError(f"the rule '{line}' cannot be read; write it as '{example}'")
    return Rule(tuple(tuple((x[0], x[2]) for x in case) for case in words), parts[2])


def _check_known(what: str, rule: Rule, word: str, known: Iterable[str]) -> None:
    if word not in known:
        raise OctarmError(f"unknown {what} in the rule '{rule}'{closest(word, known)}")


def _words(case: Iterable[Clause]) -> str:
    return " and ".join(f"{variable} is {label}" for variable, label in case)

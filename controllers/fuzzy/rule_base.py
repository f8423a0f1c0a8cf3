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

import dataclasses
import itertools
import re
from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

from octarm.errors import OctarmError, closest


class Clause(NamedTuple):
    """`variable is label`."""

    variable: str
    label: str

    def __str__(self) -> str:
        return f"{self.variable} is {self.label}"


class Rule(NamedTuple):
    """If all clauses of at least one case hold, then the conclusion.

    Attributes:
        cases: joined by OR; the clauses of each are joined by AND.
        conclusion: label of the consequent.
    """

    cases: tuple[tuple[Clause, ...], ...]
    conclusion: str

    def __str__(self) -> str:
        cases = " or ".join(_spoken(case) for case in self.cases)
        return f"if {cases} then {self.conclusion}"


@dataclasses.dataclass(frozen=True)
class RuleBase:
    """Rules in the order in which they were written.

    Attributes:
        rules: at least one.

    Raises:
        ValueError: if there are no rules, or two of them share a case.
    """

    rules: tuple[Rule, ...]

    def __post_init__(self) -> None:
        if not self.rules:
            raise OctarmError("a rule base has no rules; it needs at least one")
        seen: dict[frozenset[Clause], Rule] = {}
        for rule in self.rules:
            for case in rule.cases:
                if frozenset(case) in seen:
                    other = seen[frozenset(case)].conclusion
                    raise OctarmError(
                        f"two rules are for {_spoken(case)}, one concludes {other} and the other "
                        f"{rule.conclusion}; there may be only one"
                    )
                seen[frozenset(case)] = rule

    def __iter__(self) -> Iterator[Rule]:
        return iter(self.rules)

    def __len__(self) -> int:
        return len(self.rules)

    def __str__(self) -> str:
        return "\n".join(map(str, self.rules))

    @classmethod
    def from_sentences(cls, text: str) -> RuleBase:
        """Reads one rule a line, such as `if e is NB and rate is PS then NM`.

        Raises:
            ValueError: for a line that is not such a sentence, or two rules for one case.
        """
        return cls(tuple(_sentence(line) for line in _lines(text)))

    @classmethod
    def from_table(cls, text: str) -> RuleBase:
        """Reads a table whose first line is `row variable / column variable` and column labels.

        Raises:
            ValueError: for a first line without `/`, a row that is too short or too long, or two
                rows or columns with the same label.
        """
        lines = _lines(text)
        first, slash, rest = (lines[0] if lines else "").partition("/")
        head = rest.split()
        if not slash or len(first.split()) != 1 or len(head) < 2:
            raise OctarmError(
                f"a rule table begins with {(lines or [''])[0]!r}; it needs the variables and the "
                "labels of the columns, as in 'e / rate  N Z P'"
            )
        row_variable, (column_variable, *columns) = first.strip(), head
        rules: list[Rule] = []
        for line in lines[1:]:
            row, *conclusions = line.split()
            if len(conclusions) != len(columns):
                raise OctarmError(
                    f"row {row} of the rule table has {len(conclusions)} conclusions; it needs "
                    f"{len(columns)}, one for each label of {column_variable}"
                )
            for column, conclusion in zip(columns, conclusions, strict=True):
                case = (Clause(row_variable, row), Clause(column_variable, column))
                rules.append(Rule((case,), conclusion))
        return cls(tuple(rules))

    def check(self, inputs: Mapping[str, Iterable[str]], conclusions: Iterable[str]) -> None:
        """Checks that the rules use known words and leave no combination of labels out.

        Args:
            inputs: the labels of each input.
            conclusions: the labels that rules may conclude.

        Raises:
            ValueError: for an unknown variable or label, or a combination without a rule.
        """
        for rule in self.rules:
            for variable, label in itertools.chain.from_iterable(rule.cases):
                if variable not in inputs:
                    raise OctarmError(
                        f"unknown variable {variable!r} in the rule '{rule}'"
                        f"{closest(variable, inputs)}"
                    )
                _check_label(rule, label, f"label {label!r} of {variable}", inputs[variable])
            _check_label(rule, rule.conclusion, f"conclusion {rule.conclusion!r}", conclusions)
        missing = list(self._missing(inputs))
        if missing:
            more = f", and {len(missing) - 1} other combinations" if missing[1:] else ""
            raise OctarmError(f"no rule is for {_spoken(missing[0])}{more}; there must be one")

    def _missing(self, inputs: Mapping[str, Iterable[str]]) -> Iterator[tuple[Clause, ...]]:
        """The combinations of labels for which no case holds."""
        cases = {frozenset(case) for rule in self.rules for case in rule.cases}
        partial = [case for case in cases if len(case) < len(inputs)]
        clauses = ([Clause(name, label) for label in labels] for name, labels in inputs.items())
        for combination in itertools.product(*clauses):
            held = frozenset(combination)
            if held not in cases and not any(case <= held for case in partial):
                yield combination


def _lines(text: str) -> list[str]:
    lines = (line.partition("#")[0].strip() for line in text.splitlines())
    return [line for line in lines if line]


def _sentence(line: str) -> Rule:
    """One rule; OR separates its cases, AND the clauses of a case."""
    parts = re.fullmatch(r"if\s+(.+)\s+then\s+(\S+)", line)
    if not parts:
        raise _unreadable(line)
    cases = re.split(r"\s+or\s+", parts[1])
    return Rule(tuple(_case(case, line) for case in cases), parts[2])


def _case(text: str, line: str) -> tuple[Clause, ...]:
    words = [clause.split() for clause in re.split(r"\s+and\s+", text)]
    if any(len(clause) != 3 or clause[1] != "is" for clause in words):
        raise _unreadable(line)
    return tuple(Clause(variable, label) for variable, _, label in words)


def _unreadable(line: str) -> ValueError:
    example = "if e is NB and rate is PS then NM"
    return ValueError(f"the rule '{line}' cannot be read; write it as '{example}'")


def _check_label(rule: Rule, label: str, what: str, known: Iterable[str]) -> None:
    if label not in known:
        raise OctarmError(f"unknown {what} in the rule '{rule}'{closest(label, known)}")


def _spoken(case: Iterable[Clause]) -> str:
    return " and ".join(map(str, case))

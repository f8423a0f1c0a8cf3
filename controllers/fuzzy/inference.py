"""Fuzzy inference, eqs (43)-(50): crisp numbers in, crisp numbers out.

Four steps: the inputs become memberships of labels; each rule's antecedent becomes one number, its
weight; the weighted consequents are aggregated; the aggregate becomes a crisp number. Mamdani's
consequents are fuzzy sets, Sugeno's are functions of the inputs, eq (46).

Operators are functions, so any other norm can be given:

    AND          np.minimum, np.multiply
    OR           np.maximum, probabilistic_sum
    implication  np.minimum, np.multiply
    aggregation  np.maximum for max-min (47) and max-product, np.add for sum-min (48)

Everything is elementwise along the batch: inputs of any shapes that broadcast.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from controllers.fuzzy.membership import Membership, Triangular
from controllers.fuzzy.rule_base import RuleBase
from octarm.arrays import read_only
from octarm.errors import OctarmError, quoted

Operator = Callable[[np.ndarray, np.ndarray], np.ndarray]


def probabilistic_sum(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a + b - a b of memberships [1] of any shape, the OR that belongs to AND as a product."""
    return a + b - a * b


@dataclasses.dataclass(frozen=True)
class Variable:
    """A linguistic variable: a quantity and the labels that describe it.

    Attributes:
        name: what rules call it.
        sets: labels to membership functions, in rising order; OctarmError if there are none.
    """

    name: str
    sets: Mapping[str, Membership]

    def __post_init__(self) -> None:
        if not self.sets:
            raise OctarmError(f"{self.name} has no labels; it needs at least one")
        object.__setattr__(self, "sets", dict(self.sets))

    @classmethod
    def uniform(
        cls,
        name: str,
        labels: str | Sequence[str],
        low: float = -1.0,
        high: float = 1.0,
        family: type[Membership] = Triangular,
    ) -> Variable:
        """Labels that peak at equal distances from `low` to `high`, with open shoulders.

        Labels are in rising order, such as "NB NM NS ZE PS PM PB"; the family is the kind of
        membership functions. Raises OctarmError for fewer than two labels, one given twice, or an
        empty range.
        """
        labels = labels.split() if isinstance(labels, str) else list(labels)
        if len(labels) < 2:
            raise OctarmError(f"{name} has {len(labels)} labels; a uniform one needs at least 2")
        twice = [label for label in labels if labels.count(label) > 1]
        if twice:
            raise OctarmError(f"{name} has the label {quoted(twice[0])} more than once")
        if not (math.isfinite(high - low) and low < high):
            raise OctarmError(f"{name} goes from {low:g} to {high:g}; low must be below high")
        peaks = [-math.inf, *np.linspace(low, high, len(labels)).tolist(), math.inf]
        return cls(name, {x: family.between(*peaks[i : i + 3]) for i, x in enumerate(labels)})

    def __call__(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Membership of x in each label [1], arrays of the shape of x."""
        return {label: membership(x) for label, membership in self.sets.items()}

    def hole(self) -> float | None:
        """Some x at which no label has a membership of at least 0.001; None when none is found."""
        corners = {x for label in self.sets.values() for x in label.corners if math.isfinite(x)}
        spans = [np.linspace(a, b, 101) for a, b in itertools.pairwise(sorted(corners))]
        x = np.concatenate([[-math.inf], *spans, [math.inf]])
        bare = x[np.max(list(self(x).values()), axis=0) < 1e-3]
        return float(bare[0]) if bare.size else None


def linear(constant: float, *slopes: float) -> Callable[..., np.ndarray]:
    """The consequent z = constant + slopes[0] x + .., eq (46), shape (...) as the inputs."""

    def z(*inputs: np.ndarray) -> np.ndarray:
        terms = (slope * x for slope, x in zip(slopes, inputs, strict=True))
        return np.asarray(sum(terms, start=constant))

    return z


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class FuzzySystem:
    """Rules over some inputs; what they conclude is up to the kind of system.

    Attributes:
        inputs: the input variables, in the order in which they are passed.
        rules: what follows from what.
        conjunction: AND; above 0 where both of its sides are, so that some rule always fires.
        disjunction: OR.

    Raises:
        OctarmError: if the labels of an input leave a hole, or the rules do not fit, see
            `RuleBase.check`.
    """

    inputs: tuple[Variable, ...]
    rules: RuleBase
    conjunction: Operator = np.minimum
    disjunction: Operator = np.maximum

    def _check(self, conclusions: Iterable[str]) -> None:
        names = [variable.name for variable in self.inputs]
        for variable in self.inputs:
            if names.count(variable.name) > 1:
                raise OctarmError(
                    f"two inputs are called {quoted(variable.name)}; they need different names"
                )
            if (hole := variable.hole()) is not None:
                raise OctarmError(
                    f"{variable.name} = {hole:g} belongs to no label; known are "
                    f"{', '.join(variable.sets)}, which must overlap and be open at both ends"
                )
        self.rules.check({variable.name: variable.sets for variable in self.inputs}, conclusions)

    def _weights(self, inputs: Sequence[np.ndarray]) -> dict[str, list[np.ndarray]]:
        """How far the antecedents of the rules hold [1], by the conclusions of the rules."""
        if len(inputs) != len(self.inputs):
            names = ", ".join(variable.name for variable in self.inputs)
            raise OctarmError(f"{len(inputs)} inputs are given; the rules need {names}")
        labels = {v.name: v(x) for v, x in zip(self.inputs, inputs, strict=True)}
        weights: dict[str, list[np.ndarray]] = {}
        for rule in self.rules:
            cases = [
                functools.reduce(self.conjunction, [labels[name][label] for name, label in case])
                for case in rule.cases
            ]
            weight = functools.reduce(self.disjunction, cases)
            weights.setdefault(rule.conclusion, []).append(weight)
        return weights


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Sugeno(FuzzySystem):
    """Rules whose consequents are numbers or functions of the inputs, eq (46).

    z = sum_j w_j z_j(x, y) / sum_j w_j, with w_j the weight of rule j.

    Attributes:
        consequents: conclusion of a rule to its number, or to a function of all inputs,
            of the broadcast shape of the inputs.
    """

    consequents: Mapping[str, float | Callable[..., np.ndarray]]
    conjunction: Operator = np.multiply

    def __post_init__(self) -> None:
        self._check(self.consequents)
        object.__setattr__(self, "consequents", dict(self.consequents))

    def __call__(self, *inputs: np.ndarray) -> np.ndarray:
        """The crisp output, of the broadcast shape of the inputs."""
        above = below = 0.0
        for label, parts in self._weights(inputs).items():
            weight, z = functools.reduce(np.add, parts), self.consequents[label]
            above = above + weight * (z(*inputs) if callable(z) else z)
            below = below + weight
        return np.asarray(above / below)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Mamdani(FuzzySystem):
    """Rules whose consequents are labels of an output variable, eq (46).

    Attributes:
        output: the output variable.
        universe: the discrete elements U_i of the output, shape (n,).
        implication: a t-norm of a rule's weight and the membership of its consequent.
        aggregation: of the rules' sets.

    Raises:
        OctarmError: if no element of the universe belongs to a label of the output.
    """

    output: Variable
    universe: np.ndarray
    implication: Operator = np.minimum
    aggregation: Operator = np.maximum

    def __post_init__(self) -> None:
        self._check(self.output.sets)
        universe = read_only("universe", self.universe)
        if universe.ndim != 1 or not universe.size:
            raise OctarmError(f"universe has shape {universe.shape}; it must be (n,), n at least 1")
        object.__setattr__(self, "universe", universe)
        grades = self.output(universe)
        for rule in self.rules:
            if not np.any(grades[rule.conclusion] > 0.0):
                raise OctarmError(
                    f"no element of the universe, from {universe.min():g} to {universe.max():g}, "
                    f"belongs to {rule.conclusion} of {self.output.name}"
                )

    def coa(self, *inputs: np.ndarray) -> np.ndarray:
        """Centre of area (50) of the aggregated set, of the broadcast shape of the inputs.

        It is sum_i U_i mu(U_i) / sum_i mu(U_i), and what a call of the system gives.
        """
        return self._centre(inputs, self.aggregation)

    __call__ = coa

    def cog(self, *inputs: np.ndarray) -> np.ndarray:
        """Centre of gravity (49), the COA under sum-min (48), of the shape of `coa`."""
        return self._centre(inputs, np.add)

    def _centre(self, inputs: tuple[np.ndarray, ...], aggregation: Operator) -> np.ndarray:
        sets, grades = self._weights(inputs), self.output(self.universe)
        above = below = 0.0
        for i, u in enumerate(self.universe.tolist()):
            parts = [
                self.implication(w, grades[label][i])
                for label, weights in sets.items()
                if grades[label][i] > 0.0  # the others add nothing
                for w in weights
            ]
            if parts:
                mu = functools.reduce(aggregation, parts)
                above = above + u * mu
                below = below + mu
        return np.asarray(above / below)

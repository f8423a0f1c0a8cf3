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
import math
from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from controllers.fuzzy.membership import Family, Membership, Triangular
from controllers.fuzzy.rule_base import RuleBase
from octarm.arrays import read_only
from octarm.errors import OctarmError

Operator = Callable[[np.ndarray, np.ndarray], np.ndarray]

# A variable covers x when some label has at least this membership there.
_COVERED = 1e-3


def probabilistic_sum(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a + b - a b of memberships [1] of any shape, the OR that belongs to AND as a product."""
    return a + b - a * b


@dataclasses.dataclass(frozen=True)
class Variable:
    """A linguistic variable: a quantity and the labels that describe it.

    Attributes:
        name: what rules call it.
        sets: labels to membership functions, in rising order.

    Raises:
        ValueError: if there are no labels.
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
        family: Family = Triangular,
    ) -> Variable:
        """Labels at equal distances from `low` to `high`, the first and the last open shoulders.

        Args:
            name: what rules call it.
            labels: in rising order, such as "NB NM NS ZE PS PM PB"; at least two.
            low: where the first label peaks.
            high: where the last label peaks.
            family: the kind of membership functions.

        Raises:
            ValueError: for fewer than two labels, a label given twice, or an empty range.
        """
        labels = labels.split() if isinstance(labels, str) else list(labels)
        if len(labels) < 2:
            raise OctarmError(f"{name} has {len(labels)} labels; a uniform one needs at least 2")
        twice = [label for label in labels if labels.count(label) > 1]
        if twice:
            raise OctarmError(f"{name} has the label {twice[0]!r} more than once")
        if not (math.isfinite(high - low) and low < high):
            raise OctarmError(f"{name} goes from {low:g} to {high:g}; low must be below high")
        peaks = [-math.inf, *np.linspace(low, high, len(labels)).tolist(), math.inf]
        return cls(
            name,
            {label: family.between(*peaks[i : i + 3]) for i, label in enumerate(labels)},
        )

    def __call__(self, x: np.ndarray) -> dict[str, np.ndarray]:
        """Membership of x in each label [1], arrays of the shape of x."""
        return {label: membership(x) for label, membership in self.sets.items()}

    def hole(self) -> float | None:
        """Some x at which no label has a membership of at least 0.001; None when there is none."""
        covered = -math.inf
        for low, high in sorted(membership.cut(_COVERED) for membership in self.sets.values()):
            if low > covered:
                return low - 1.0 if covered == -math.inf else 0.5 * (covered + low)
            covered = max(covered, high)
        return None if covered == math.inf else covered + 1.0


@dataclasses.dataclass(frozen=True)
class Linear:
    """The consequent z = constant + slopes[0] x + slopes[1] y + .., eq (46).

    Attributes:
        constant: its value at the origin.
        slopes: one for each input.
    """

    constant: float
    slopes: tuple[float, ...]

    def __call__(self, *inputs: np.ndarray) -> np.ndarray:
        """The consequent at these inputs, of the broadcast shape of the inputs.

        Raises:
            ValueError: unless there is one slope an input.
        """
        if len(inputs) != len(self.slopes):
            raise OctarmError(
                f"a consequent has {len(self.slopes)} slopes for {len(inputs)} inputs"
            )
        z = self.constant
        for slope, x in zip(self.slopes, inputs, strict=True):
            z = z + slope * x
        return np.asarray(z)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Sugeno:
    """Rules whose consequents are numbers or functions of the inputs, eq (46).

    z = sum_j w_j z_j(x, y) / sum_j w_j, with w_j the weight of rule j.

    Attributes:
        inputs: the input variables, in the order in which they are passed.
        rules: what follows from what.
        consequents: conclusion of a rule to its number, or to a function of all inputs,
            of the broadcast shape of the inputs.
        conjunction: AND; above 0 where both of its sides are, so that some rule always fires.
        disjunction: OR.

    Raises:
        ValueError: if the labels of an input leave a hole, or the rules do not fit, see
            `RuleBase.check`.
    """

    inputs: tuple[Variable, ...]
    rules: RuleBase
    consequents: Mapping[str, float | Callable[..., np.ndarray]]
    conjunction: Operator = np.multiply
    disjunction: Operator = np.maximum

    def __post_init__(self) -> None:
        _check_inputs(self.inputs, self.rules, self.consequents)
        object.__setattr__(self, "consequents", dict(self.consequents))

    def __call__(self, *inputs: np.ndarray) -> np.ndarray:
        """The crisp output, of the broadcast shape of the inputs."""
        weights = _weights(self, inputs)
        above = below = 0.0
        for label, parts in _by_conclusion(self.rules, weights).items():
            weight, z = functools.reduce(np.add, parts), self.consequents[label]
            above = above + weight * (z(*inputs) if callable(z) else z)
            below = below + weight
        return np.asarray(above / below)


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Mamdani:
    """Rules whose consequents are labels of an output variable, eq (46).

    Attributes:
        inputs: the input variables, in the order in which they are passed.
        output: the output variable.
        rules: what follows from what.
        universe: the discrete elements U_i of the output, shape (n,).
        conjunction: AND; above 0 where both of its sides are, so that some rule always fires.
        disjunction: OR.
        implication: a t-norm of a rule's weight and the membership of its consequent.
        aggregation: of the rules' sets.

    Raises:
        ValueError: if the labels of an input leave a hole, the rules do not fit, see
            `RuleBase.check`, or no element of the universe belongs to a label of the output.
    """

    inputs: tuple[Variable, ...]
    output: Variable
    rules: RuleBase
    universe: np.ndarray
    conjunction: Operator = np.minimum
    disjunction: Operator = np.maximum
    implication: Operator = np.minimum
    aggregation: Operator = np.maximum

    def __post_init__(self) -> None:
        _check_inputs(self.inputs, self.rules, self.output.sets)
        universe = read_only("universe", self.universe)
        if universe.ndim != 1 or not universe.size:
            raise OctarmError(f"universe has shape {universe.shape}; it must be (n,), n at least 1")
        object.__setattr__(self, "universe", universe)
        found = {label for _, grades in self._slices for label, _ in grades}
        for rule in self.rules:
            if rule.conclusion not in found:
                raise OctarmError(
                    f"no element of the universe, from {universe.min():g} to {universe.max():g}, "
                    f"belongs to {rule.conclusion} of {self.output.name}"
                )

    def __call__(self, *inputs: np.ndarray) -> np.ndarray:
        """The crisp output by COA, of the broadcast shape of the inputs."""
        return self.coa(*inputs)

    def coa(self, *inputs: np.ndarray) -> np.ndarray:
        """Centre of area (50): of the aggregated set, sum_i U_i mu(U_i) / sum_i mu(U_i).

        Of the broadcast shape of the inputs.
        """
        return self._centre(inputs, self.aggregation)

    def cog(self, *inputs: np.ndarray) -> np.ndarray:
        """Centre of gravity (49): of all rules' sets, which is COA under sum-min (48).

        Of the broadcast shape of the inputs.
        """
        return self._centre(inputs, np.add)

    def _centre(self, inputs: tuple[np.ndarray, ...], aggregation: Operator) -> np.ndarray:
        weights = _weights(self, inputs)
        sets = _by_conclusion(self.rules, weights)
        if aggregation is np.maximum:  # max_j T(w_j, mu) = T(max_j w_j, mu) for any t-norm T
            sets = {label: [functools.reduce(np.maximum, w)] for label, w in sets.items()}
        above = below = 0.0
        for u, grades in self._slices:
            parts = [self.implication(w, mu) for label, mu in grades for w in sets.get(label, ())]
            if parts:
                mu = functools.reduce(aggregation, parts)
                above = above + u * mu
                below = below + mu
        return np.asarray(above / below)

    @functools.cached_property
    def _slices(self) -> list[tuple[float, list[tuple[str, np.ndarray]]]]:
        """Each element of the universe with the labels it belongs to; the others add nothing."""
        grades = self.output(self.universe)
        return [
            (float(u), [(label, mu[i]) for label, mu in grades.items() if mu[i] > 0.0])
            for i, u in enumerate(self.universe)
        ]


def _check_inputs(inputs: Sequence[Variable], rules: RuleBase, conclusions: Iterable[str]) -> None:
    for i, variable in enumerate(inputs):
        if variable.name in [other.name for other in inputs[:i]]:
            raise OctarmError(f"two inputs are called {variable.name!r}; they need different names")
        hole = variable.hole()
        if hole is not None:
            raise OctarmError(
                f"{variable.name} = {hole:g} belongs to no label; known are "
                f"{', '.join(variable.sets)}, which must overlap and be open at both ends"
            )
    rules.check({variable.name: variable.sets for variable in inputs}, conclusions)


def _weights(system: Sugeno | Mamdani, inputs: Sequence[np.ndarray]) -> list[np.ndarray]:
    """How far the antecedent of each rule holds [1]."""
    if len(inputs) != len(system.inputs):
        names = ", ".join(variable.name for variable in system.inputs)
        raise OctarmError(f"{len(inputs)} inputs are given; the rules need {names}")
    labels = {v.name: v(x) for v, x in zip(system.inputs, inputs, strict=True)}
    weights: list[np.ndarray] = []
    for rule in system.rules:
        cases = [
            functools.reduce(system.conjunction, [labels[name][label] for name, label in case])
            for case in rule.cases
        ]
        weights.append(functools.reduce(system.disjunction, cases))
    return weights


def _by_conclusion(rules: RuleBase, weights: Sequence[np.ndarray]) -> dict[str, list[np.ndarray]]:
    sets: dict[str, list[np.ndarray]] = {}
    for rule, weight in zip(rules, weights, strict=True):
        sets.setdefault(rule.conclusion, []).append(weight)
    return sets

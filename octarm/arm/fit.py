"""The chain of few modules that stands best for a finer one: its parameters by least squares.

The lengths of the modules stay those of the groups of the finer chain, since they say what the
coordinates mean. Masses, inertias, stiffness, width and damping are fitted, as logarithms of their
ratio to where the search starts, which keeps them positive. What is compared is linear, about the
hanging equilibrium:

- statics: what forces on the tip, along and across, and couples on the plates at the ends of the
  groups do to each other's places and angles; and what weight along and across does to the tip, and
  weight across to the plates;
- modes: the lowest frequencies, two of bending and one of stretching;
- transient: how the tip follows a step of force along it and across it, and the last plate a step
  of couple, over three periods of the slowest mode.

The residual of statics is the rms of errors, each relative to the geometric mean of both loads' own
compliances; that of modes the rms of the logarithms of ratios; that of transients the rms over time
relative to the final value. They have equal weight. A hundredth of the logarithms of the
parameters' ratios is added, which holds what the rest does not determine.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import least_squares

from octarm.arm import lagrange
from octarm.arm.kinematics import jacobian, tip_force
from octarm.arm.modes import state_matrix
from octarm.arm.parameters import MOST_MODULES, ArmParameters
from octarm.arm.rod import Rod, arm_from_rod, check_layout, lumped
from octarm.errors import OctarmError

_FITTED = ("mass", "inertia", "stiffness", "width", "damping")
_FINE = 10  # modules for each one of the fitted chain, where a rod is given
_LARGEST = 50.0  # ratio of a parameter to where it starts
_MOST_TRIALS = 100  # undamped chains, whose phases compete, need more than the usual 20
_PRIOR = 0.01  # weight of the logarithm of such a ratio
_PERIODS, _SAMPLES = 3.0, 150  # of the transients
_GRAVITY = 9.81  # of the weight that is put on, whatever the arm hangs in [m/s^2]


class Behaviour(NamedTuple):
    """Statics, modes and transients of an arm of m groups of modules.

    Attributes:
        compliance: outputs by unit loads, shape (2 + m, 2 + m), symmetric [m/N] to [rad/(N m)].
        weight: the tip along by weight along; the tip across and the plates by weight across,
            shape (2 + m,) [m], [rad].
        frequencies: the lowest ones of bending, two unless m = 1, and the lowest of stretching,
            shape (k,) [Hz].
        response: of the tip along, the tip across and the last plate to a unit step of their own
            load at the times asked for, shape (3, T) [m/N], [rad/(N m)].
    """

    compliance: np.ndarray
    weight: np.ndarray
    frequencies: np.ndarray
    response: np.ndarray

    @property
    def finals(self) -> np.ndarray:
        """What the responses tend to, shape (3,) [m/N], [rad/(N m)]."""
        return np.diag(self.compliance)[[0, 1, -1]]

    def errors(self, right: Behaviour) -> Behaviour:
        """The errors relative to those of another arm, in the same places [1].

        Of compliances relative to the geometric mean of both loads' own ones, of frequencies as the
        logarithms of ratios, of responses relative to what they tend to.
        """
        size = np.sqrt(np.diag(right.compliance))
        return Behaviour(
            (self.compliance - right.compliance) / np.outer(size, size),
            self.weight / right.weight - 1.0,
            np.log(self.frequencies / right.frequencies),
            (self.response - right.response) / right.finals[:, None],
        )


def behaviour_of(p: ArmParameters, groups: int, times: np.ndarray) -> Behaviour:
    """The behaviour of one arm, linearised about its hanging equilibrium.

    The number of groups m divides that of the modules; the times of the responses have shape (T,)
    [s]. Raises OctarmError if the arm has no equilibrium.
    """
    q = lagrange.equilibrium(p)
    stiffness, inertia = lagrange.potential_hessian(p, q), lagrange.mass_matrix(p, q)
    loads = _loads(p, q, groups)
    weights = _GRAVITY * np.einsum("b,bxi->xi", p.mass, jacobian(q))
    moved = loads @ np.linalg.solve(stiffness, np.vstack([loads, weights]).T)
    m = len(loads)
    bending, stretching = _frequencies(stiffness, inertia)
    return Behaviour(
        compliance=moved[:, :m],
        weight=np.concatenate([moved[:1, m], moved[1:, m + 1]]),
        frequencies=np.concatenate([bending[: min(groups, 2)], stretching[:1]]),
        response=_responses(state_matrix(p, q), inertia, loads[[0, 1, -1]], times),
    )


def _loads(p: ArmParameters, q: np.ndarray, groups: int) -> np.ndarray:
    """The generalised forces of unit loads, which are the slopes of the outputs, (2 + m, 2N)."""
    n, b = p.modules, p.entries.tip_length
    plates = np.zeros((groups, 2 * n))
    ends = (np.arange(groups) + 1) * (n // groups)
    plates[:, n:] = np.arange(n) < ends[:, None]
    return np.array([tip_force(q, 1.0, 0.0, b), tip_force(q, 0.0, 1.0, b), *plates])


def _frequencies(stiffness: np.ndarray, inertia: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies of bending and of stretching, ascending, shape (N,) each [Hz].

    The N modes that have the smallest share of their energy in slides are those of bending.
    """
    n = len(inertia) // 2
    squares, modes = eigh(stiffness, inertia)
    sliding = np.einsum("ik,ij,jk->k", modes[:n], inertia[:n, :n], modes[:n])
    order = np.argsort(sliding, kind="stable")
    hertz = np.sqrt(np.maximum(squares, 0.0)) / (2.0 * np.pi)
    return np.sort(hertz[order[:n]]), np.sort(hertz[order[n:]])


def _responses(
    state: np.ndarray, inertia: np.ndarray, loads: np.ndarray, times: np.ndarray
) -> np.ndarray:
    """Outputs after a step of their own load, shape (k, T) for loads of shape (k, 2N).

    x(t) = A^-1 (exp(A t) - 1) B, by the eigenvectors of A.
    """
    rates, vectors = np.linalg.eig(state)
    pushes = np.linalg.solve(inertia, loads.T)
    start = np.linalg.solve(vectors, np.vstack([np.zeros_like(pushes), pushes]))
    outputs = loads @ vectors[: loads.shape[1]]
    growth = (np.exp(np.outer(rates, times)) - 1.0) / rates[:, None]
    return np.einsum("jk,kj,kt->jt", outputs, start, growth).real


class FitRow(NamedTuple):
    """One quantity of the fine chain, for a transient its final value, and the errors of others.

    `before` and `after` are the relative errors [1] of the lumped chain, from which the search
    starts, and of the fitted one.
    """

    kind: str
    what: str
    value: float
    unit: str
    before: float
    after: float


@dataclasses.dataclass(frozen=True)
class Fit:
    """A fitted chain, the lumped one from which the search started, and the errors of both."""

    parameters: ArmParameters
    start: ArmParameters
    rows: tuple[FitRow, ...]

    def rms(self, kind: str) -> tuple[float, float]:
        """The rms of the errors of one kind, before and after [1]."""
        errors = np.array([(row.before, row.after) for row in self.rows if row.kind == kind])
        before, after = np.sqrt(np.mean(errors**2, axis=0))
        return float(before), float(after)

    def __str__(self) -> str:
        """The errors and the parameters as tables."""
        lines = [f"{'quantity':<46} {'fine chain':>19} {'lumped':>9} {'fitted':>9}"]
        for row in self.rows:
            value = f"{row.value:.4g} {row.unit}"
            errors = f"{100.0 * row.before:>+7.1f} % {100.0 * row.after:>+7.1f} %"
            lines.append(f"{f'{row.kind}: {row.what}':<46} {value:>19} {errors}")
        for kind in dict.fromkeys(row.kind for row in self.rows):
            before, after = self.rms(kind)
            name = f"{kind}, rms of all"
            lines.append(f"{name:<66} {100.0 * before:>7.1f} % {100.0 * after:>7.1f} %")
        lines += ["", f"{'parameter':<14} {'lumped':>38} {'fitted':>38}"]
        for field in _FITTED:
            pairs = [np.atleast_2d(getattr(p, field)) for p in (self.start, self.parameters)]
            for before, after in zip(*pairs, strict=True):
                texts = (" ".join(f"{x:>12.5g}" for x in row) for row in (before, after))
                lines.append(f"{field:<14} {' '.join(texts)}")
        return "\n".join(lines)


def fit_modules(plant: ArmParameters | Rod, modules: int = 3, layout: str = "paper") -> Fit:
    """The chain of few modules, in a layout of `octarm.arm.rod`, that stands best for a finer one.

    For a rod a centred chain of ten times as many modules stands. Raises OctarmError for another
    layout, a number of modules that does not divide the plant's, a batch of plants, or a plant that
    does not hang stably.
    """
    check_layout(layout)
    if isinstance(plant, Rod):
        size = max(1, min(_FINE, MOST_MODULES // max(modules, 1)))
        plant = arm_from_rod(plant, size * modules, "centred")
    if plant.batch_shape:
        raise OctarmError(f"the plant has batch axes {plant.batch_shape}; one arm is fitted")
    start = lumped(plant, modules, layout)
    slowest = float(behaviour_of(plant, modules, np.zeros(1)).frequencies[0])
    if not slowest > 0.0:
        raise OctarmError("the plant does not hang stably, so that it has no slowest oscillation")
    times = _PERIODS / slowest / _SAMPLES * np.arange(1, _SAMPLES + 1)
    right = behaviour_of(plant, modules, times)

    def errors(p: ArmParameters) -> Behaviour:
        return behaviour_of(p, modules, times).errors(right)

    def residual(x: np.ndarray) -> np.ndarray:
        return np.concatenate([*_residuals(errors(_moved(start, x))), _PRIOR * x])

    bound = np.log(_LARGEST)
    start_at = np.zeros(len(_FITTED) * modules)
    search = least_squares(residual, start_at, bounds=(-bound, bound), max_nfev=_MOST_TRIALS)
    x: np.ndarray = search.x
    fitted = _moved(start, x)
    rows = tuple(_rows(right, errors(start), errors(fitted)))
    return Fit(fitted, start, rows)


def _moved(start: ArmParameters, x: np.ndarray) -> ArmParameters:
    """The start with each fitted parameter of each module multiplied by exp(x), shape (5 N,)."""
    factors = np.exp(x.reshape(len(_FITTED), -1))
    return start.scaled(**dict(zip(_FITTED, factors, strict=True)))


def _residuals(errors: Behaviour) -> list[np.ndarray]:
    """Statics, modes and transients, each with squares that sum up to their mean square."""
    statics = errors.compliance[np.triu_indices(len(errors.compliance))]
    parts = (np.concatenate([statics, errors.weight]), errors.frequencies, errors.response.ravel())
    return [part / np.sqrt(part.size) for part in parts]


def _rows(right: Behaviour, before: Behaviour, after: Behaviour) -> Iterator[FitRow]:
    m = len(right.weight) - 2
    loads = ["force along", "force across", *(f"couple {b + 1}" for b in range(m))]
    outputs = ["tip along", "tip across", *(f"plate {b + 1}" for b in range(m))]
    per = ["m/N", "m/N", *["rad/(N m)"] * m]
    size = np.sqrt(np.diag(right.compliance))
    for i, j in itertools.combinations_with_replacement(range(m + 2), 2):
        value = float(right.compliance[i, j])
        if abs(value) < 1e-9 * size[i] * size[j]:  # along and across do not meet
            continue
        unit = "1/N" if i < 2 <= j else per[j]
        errors = (float(e.compliance[i, j]) for e in (before, after))
        yield FitRow("statics", f"{outputs[i]}, {loads[j]}", value, unit, *errors)
    for i, output in enumerate(outputs):
        errors = (float(e.weight[i]) for e in (before, after))
        what = f"{output}, weight {'across' if i else 'along'}"
        yield FitRow("statics", what, float(right.weight[i]), "m" if i < 2 else "rad", *errors)
    modes = [*(f"bending {k + 1}" for k in range(len(right.frequencies) - 1)), "stretching 1"]
    for k, mode in enumerate(modes):
        errors = (float(np.expm1(e.frequencies[k])) for e in (before, after))
        yield FitRow("modes", mode, float(right.frequencies[k]), "Hz", *errors)
    for k, i in enumerate((0, 1, m + 1)):
        errors = (
            float(np.linalg.norm(e.response[k])) / len(e.response[k]) ** 0.5
            for e in (before, after)
        )
        what = f"{outputs[i]}, step of {loads[i]}"
        yield FitRow("transient", what, float(right.finals[k]), per[i], *errors)

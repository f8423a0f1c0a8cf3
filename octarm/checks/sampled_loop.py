"""Whether a sampled loop about rest is stable, before anything is simulated.

The plant hangs still. About that, with x = (q - q0, v) and a generalised force held over a control
period T, it moves by x' = A x + G Q, hence from period to period by

    x[k+1] = Phi(T) x[k] + Gamma(T) Q[k],      Phi = exp(A T),  Gamma = integral of exp(A t) G.

The law measures M x and answers with Q; it may keep a state z. Its slopes at rest on a reference
that rests there are taken by differences of the law itself:

    Q[k] = F M x[k] + C z[k],      z[k+1] = R M x[k] + S z[k].

Together this is one linear map. The loop is stable where its spectral radius is below 1: necessary
for any motion about rest, and sufficient for small ones. States of the law that never show in Q,
such as the centres of rules that have learnt nothing, are left out: they do not move.

A plant of more modules than the model is measured by q_model = B q, and Q = B^T Q_model acts on it.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, cast

import numpy as np
from scipy.linalg import expm

from octarm.arm import lagrange
from octarm.arm.modes import state_matrix
from octarm.arm.parameters import ArmParameters
from octarm.arrays import coordinate_names
from octarm.errors import OctarmError
from octarm.interfaces import Controller, Measurement, Reference

SHORTEST, LONGEST = 1e-6, 0.2  # control periods that are looked at [s]
_FACTOR = 1.1  # between periods that are tried
_ALIKE = 1e7  # condition of eigenvectors, beyond which they are not used
_SMALL = 1e-6  # relative size of differences
_UNLIKE = 0.02  # share by which slopes of a smooth law may differ between two sizes
_UNSEEN = 1e-7  # share of what a state does to Q below which it does nothing


class NoSlopeError(OctarmError):
    """A law that has no derivative at rest, such as one with sgn(s)."""


@dataclasses.dataclass(frozen=True, eq=False)
class LinearPlant:
    """A plant about where it hangs: x' = A x + G Q, measured as M x.

    Attributes:
        A: state matrix, shape (m, m) [1/s].
        G: what the model's generalised force does, shape (m, 2N).
        M: what is measured of q and v in the model's coordinates, shape (4N, m).
        rest: the model's coordinates at rest, shape (2N,) [m], [rad].
        names: of the plant's coordinates, of which the first m/2 states are.
        inertia: what each of them moves, D_ii, shape (m/2,) [kg], [kg m^2].
    """

    A: np.ndarray
    G: np.ndarray
    M: np.ndarray
    rest: np.ndarray
    names: Sequence[str]
    inertia: np.ndarray

    @classmethod
    def of(
        cls, p: ArmParameters, sums: np.ndarray | None = None, rest: np.ndarray | None = None
    ) -> LinearPlant:
        """The hanging arm.

        B leads from its coordinates to the model's, shape (2N, 2N_plant), the identity if None;
        `rest` is where the model's coordinates hang, shape (2N,), B q if None.
        """
        q = lagrange.equilibrium(p)
        B = np.eye(len(q)) if sums is None else sums
        inertia = lagrange.mass_matrix(p, q)
        push = np.linalg.solve(inertia, B.T)
        zero = np.zeros_like(B)
        return cls(
            A=state_matrix(p, q),
            G=np.concatenate([np.zeros_like(push), push]),
            M=np.block([[B, zero], [zero, B]]),
            rest=B @ q if rest is None else rest,
            names=coordinate_names(p.modules),
            inertia=np.diagonal(inertia),
        )

    @functools.cached_property
    def _modes(self) -> tuple[np.ndarray, np.ndarray, np.ndarray] | None:
        """Eigenvalues, eigenvectors, and G in their terms; None if they hardly differ."""
        rates, shapes = np.linalg.eig(self.A)
        if np.linalg.cond(shapes) > _ALIKE:
            return None
        return rates, shapes, np.linalg.solve(shapes, self.G.astype(complex))

    def sampled(self, period: float) -> tuple[np.ndarray, np.ndarray]:
        """Phi and Gamma of a control period [s], shapes (m, m) and (m, 2N)."""
        if self._modes is not None:  # ten times as fast for sixty modules
            rates, shapes, push = self._modes
            phi = np.linalg.solve(shapes.T, (shapes * np.exp(rates * period)).T).T
            still = rates == 0.0
            means = np.where(still, period, np.expm1(rates * period) / np.where(still, 1.0, rates))
            gamma = (shapes * means) @ push
            return np.real(phi), np.real(gamma)
        m, k = self.G.shape
        both = np.zeros((m + k, m + k))
        both[:m, :m], both[:m, m:] = self.A, self.G
        step = expm(period * both)
        return step[:m, :m], step[:m, m:]


class LinearLaw(NamedTuple):
    """A law about rest: Q = F y + C z and z' = R y + S z for a measured y = (q - rest, v).

    Attributes:
        F: shape (2N, 4N).
        C: shape (2N, k) for k states.
        R: shape (k, 4N).
        S: shape (k, k).
    """

    F: np.ndarray
    C: np.ndarray
    R: np.ndarray
    S: np.ndarray


def linear_law(controller: Controller, rest: np.ndarray, period: float) -> LinearLaw:
    """The slopes of a law at rest on a reference that rests there, by central differences.

    It is called for arms without batch axes at `rest`, shape (2N,) [m], [rad], a period [s] apart.
    Raises NoSlopeError if the law has no derivative there.
    """
    fine, coarse = (_slopes(controller, rest, period, h) for h in (_SMALL, 10.0 * _SMALL))
    for name, a, b in zip(("measurements", "its state"), fine, coarse, strict=True):
        size = np.maximum(np.abs(a), np.abs(b)).max(axis=0, initial=0.0)
        if np.any(np.abs(a - b) > _UNLIKE * size + 1e-9):
            raise NoSlopeError(
                f"no derivative by {name} at rest, as of a law that switches by sgn(s)"
            )
    by_y, by_z = fine
    n = len(rest)
    return _seen(LinearLaw(by_y[:n], by_z[:n], by_y[n:], by_z[n:]))


def _slopes(
    controller: Controller, rest: np.ndarray, period: float, h: float
) -> tuple[np.ndarray, np.ndarray]:
    """d(Q, z')/d(q, v) and d(Q, z')/dz, shapes (2N + k, 4N) and (2N + k, k)."""
    n = len(rest)

    def answers(away: np.ndarray, turned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(Q, z') and the z before, for changes of (q, v) and of z, if any, a row each."""
        rows = len(away)
        still, zero = np.tile(rest, (rows, 1)), np.zeros((rows, n))
        reference = Reference(still, zero, zero)
        start = controller.initial_state((rows,))
        _, state = controller(start, Measurement(0.0, still, zero), reference)  # knows the time now
        z, begin = _flat(state, rows), 0
        for array in _arrays(state, rows) if turned.size else []:
            end = begin + array[0].size
            array += turned[:, begin:end].reshape(array.shape)
            begin = end
        measured = Measurement(period, rest + away[:, :n], away[:, n:])
        command, after = controller(state, measured, reference)
        force = np.broadcast_to(command.force, (rows, n))
        return np.concatenate([force, _flat(after, rows)], axis=1), z

    steps = h * np.concatenate([np.abs(rest[: n // 2]), np.ones(n // 2), np.ones(n)])
    out, z = answers(np.concatenate([np.diag(steps), -np.diag(steps)]), np.empty(0))
    by_y = (out[: 2 * n] - out[2 * n :]) / (2.0 * steps[:, None])
    k = z.shape[1]
    if not k:
        return by_y.T, np.empty((n, 0))
    # A state may be small: an integral of e that gives way at 1e-5 m s acts like any other.
    learnt = 1e-3 * h * (1.0 + np.abs(z[-1]))
    changes = np.concatenate([np.diag(learnt), -np.diag(learnt)])
    out, _ = answers(np.zeros((2 * k, 2 * n)), changes)
    return by_y.T, ((out[:k] - out[k:]) / (2.0 * learnt[:, None])).T


def _flat(state: Any, rows: int) -> np.ndarray:
    """The numbers of a state that each arm has, shape (rows, k)."""
    parts = [part.reshape(rows, -1) for part in _arrays(state, rows)]
    return np.concatenate([np.empty((rows, 0)), *parts], axis=1)


def _arrays(state: Any, rows: int) -> list[np.ndarray]:
    """The arrays of floats with an axis of arms in a state, in order."""
    match state:
        case np.ndarray():
            array = cast(np.ndarray, state)
            return [array] if array.dtype.kind == "f" and array.shape[:1] == (rows,) else []
        case dict():
            parts = list(cast(Mapping[Any, Any], state).values())
        case tuple() | list():
            parts = list(cast(Sequence[Any], state))
        case _ if dataclasses.is_dataclass(state):
            parts = [getattr(state, field.name) for field in dataclasses.fields(state)]
        case _:
            return []
    return [array for part in parts for array in _arrays(part, rows)]


def _seen(law: LinearLaw) -> LinearLaw:
    """The law without states that never show in Q.

    The rows of C, C S, C S^2, .. span what shows; as S changes nothing outside their span, the
    states can be replaced by their shares along it.
    """
    k = law.S.shape[0]
    scale = np.abs(law.C).max(initial=0.0)
    basis = np.empty((0, k))
    if k and scale > 0.0:
        rows = law.C / scale
        while len(rows):
            _, sizes, across = np.linalg.svd(rows - rows @ basis.T @ basis, full_matrices=False)
            new = across[sizes > _UNSEEN]
            basis = np.concatenate([basis, new])
            rows = new @ law.S
    return LinearLaw(law.F, law.C @ basis.T, basis @ law.R, basis @ law.S @ basis.T)


class Loop:
    """A plant and a law, at any control period."""

    def __init__(self, plant: LinearPlant, controller: Controller) -> None:
        """The loop; `NoSlopeError` if the law has no derivative at rest."""
        self.plant = plant
        self._law: Callable[[float], LinearLaw] = lambda T: linear_law(controller, plant.rest, T)
        first = self._law(1e-3)
        if not len(first.S):  # what has no state does not depend on the time between calls
            self._law = lambda T: first

    def matrix(self, period: float) -> np.ndarray:
        """The map of (x, z) over a control period [s], shape (m + k, m + k)."""
        (phi, gamma), law, M = self.plant.sampled(period), self._law(period), self.plant.M
        return np.block([[phi + gamma @ law.F @ M, gamma @ law.C], [law.R @ M, law.S]])

    def radius(self, period: float) -> float:
        """The spectral radius at a control period [s]; the loop is stable where it is below 1."""
        return float(np.max(np.abs(np.linalg.eigvals(self.matrix(period)))))

    def longest_period(self) -> float:
        """The control period up to which the loop is stable [s].

        0 if it is not at the shortest one that is looked at, inf if it is at all of them.
        """
        if not self.radius(SHORTEST) < 1.0:
            return 0.0
        stable, period = SHORTEST, SHORTEST
        while period < LONGEST:
            period *= _FACTOR
            if not self.radius(period) < 1.0:
                break
            stable = period
        else:
            return math.inf
        while period - stable > 1e-4 * stable:
            middle = 0.5 * (stable + period)
            stable, period = (middle, period) if self.radius(middle) < 1.0 else (stable, middle)
        return stable


class LoopMode(NamedTuple):
    """What a loop does in the direction in which it grows fastest, or decays slowest.

    Attributes:
        radius: by which it grows in a control period [1].
        frequency: at which it swings [Hz]; half the sampling rate if it alternates.
        coordinate: of the plant that has most of the kinetic energy.
        mode: of the plant without dampers that has the largest share in it, counted from 1.
        plant_frequency: frequency of that mode [Hz].
    """

    radius: float
    frequency: float
    coordinate: str
    mode: int
    plant_frequency: float


def first_mode(loop: Loop, period: float) -> LoopMode:
    """The mode of a loop that grows fastest at a control period [s]."""
    values, vectors = np.linalg.eig(loop.matrix(period))
    worst = int(np.argmax(np.abs(values)))
    plant, n = loop.plant, len(loop.plant.names)
    state = vectors[: 2 * n, worst]
    energy = plant.inertia * np.abs(state[n:]) ** 2
    squares, shapes = np.linalg.eig(-plant.A[n:, :n])  # of D^-1 K
    size = np.sqrt(np.sum(plant.inertia[:, None] * np.abs(shapes) ** 2, axis=0))
    most = int(np.argmax(np.abs(np.linalg.solve(shapes, state[n:])) * size))
    square = np.real(squares)
    return LoopMode(
        radius=float(np.abs(values[worst])),
        frequency=abs(float(np.angle(values[worst]))) / (2.0 * math.pi * period),
        coordinate=plant.names[int(np.argmax(energy))],
        mode=int(np.sum(square < square[most])) + 1,
        plant_frequency=math.sqrt(max(0.0, float(square[most]))) / (2.0 * math.pi),
    )

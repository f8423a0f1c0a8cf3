"""What an arm does about its hanging equilibrium, in the few numbers by which chains are compared.

Loads are forces on the tip along and across the arm, and couples on the plates that end groups of
modules; outputs are the places and angles that do work with them.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.linalg import eigh

from octarm.arm import lagrange
from octarm.arm.kinematics import jacobian, tip_force
from octarm.arm.modes import state_matrix
from octarm.arm.parameters import ArmParameters

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

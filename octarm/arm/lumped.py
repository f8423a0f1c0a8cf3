"""The chain of few modules that has the sums of a finer one's groups."""

from __future__ import annotations

import numpy as np

from octarm.arm import lagrange
from octarm.arm.parameters import ArmParameters
from octarm.errors import OctarmError


def group_sums(groups: int, size: int, *, halved: bool) -> tuple[np.ndarray, np.ndarray]:
    """Sums over groups of so many modules, of slides and of hinges, shapes (M, N) [1].

    Slides at the borders of groups may be shared in halves.
    """
    hinges = np.repeat(np.eye(groups), size, axis=1)
    slides = hinges.copy()
    for b in range(1, groups if halved else 1):
        slides[b - 1 : b + 1, b * size] = 0.5
    return slides, hinges


def lumped(plant: ArmParameters, modules: int, layout: str = "paper") -> ArmParameters:
    """A chain of few modules, in some layout, that has the sums of a finer one's groups.

    Masses, inertias, lengths and bends without force add up, as do compliances; dampers take what
    the group dissipates under a force. Only columns remain: what the finer chain has in a backbone
    goes into their stiffness and width. Where a rigid tip piece follows the plant, groups end
    between hinges, and share the slide there in halves. From a chain that stands for a rod without
    tapering it makes the one of `octarm.arm.rod` in the layout `paper`, up to what the rigid piece
    does not stretch. The input range is that of the plant if it is one for all columns, else none.

    Raises OctarmError if the number of groups does not divide that of the plant's modules.
    """
    size, rest = divmod(plant.modules, max(modules, 1))
    if rest or modules < 1:
        raise OctarmError(
            f"{modules} groups were to be made of {plant.modules} modules; "
            "their number must divide that of the modules"
        )
    slides, hinges = group_sums(modules, size, halved=bool(plant.tip_length > 0.0))
    n = plant.modules
    stiffness, damping = (
        np.diag(matrix(plant)) for matrix in (lagrange.stiffness_matrix, lagrange.damping_matrix)
    )
    give = slides @ (1.0 / stiffness[:n])  # of the slides [m/N]
    bend = hinges @ (1.0 / stiffness[n:])  # of the hinges [rad/(N m)]
    lost = slides @ (damping[:n] / stiffness[:n] ** 2)  # power under a force's rate [m s/N]
    sizes = np.sum(slides, axis=1)
    springs, dampers = (
        _shares(columns) @ slides.T / sizes for columns in (plant.stiffness, plant.damping)
    )
    length, inertia, tip = slides @ plant.rest_length, hinges @ plant.inertia, 0.0
    length[-1] += plant.tip_length
    if layout == "centred":
        # Slides lead from the middle of a group to that of the next one, and plates turn with the
        # halves on both sides of them; the base holds the first half.
        halves = 0.5 * (np.eye(modules) + np.eye(modules, k=-1))
        tip = 0.5 * float(length[-1])
        length, give, lost = (halves @ x for x in (length, give, lost))
        inertia = halves.T @ inertia
    bounds = plant.input_range
    return ArmParameters(
        mass=hinges @ plant.mass,
        inertia=inertia,
        width=2.0 * np.sqrt(give / bend),
        stiffness=springs / give,
        damping=dampers * lost / give**2,
        rest_length=length,
        rest_angle=hinges @ np.broadcast_to(plant.rest_angle, n),
        gravity=plant.gravity,
        tip_length=tip,
        input_range=bounds if bounds.shape == (2, 1) else (-np.inf, np.inf),
    )


def _shares(columns: np.ndarray) -> np.ndarray:
    """What each column has of both, shape (2, N); a half where there is nothing."""
    total = np.sum(columns, axis=0)
    some = total > 0.0
    return np.where(some, columns / np.where(some, total, 1.0), 0.5)

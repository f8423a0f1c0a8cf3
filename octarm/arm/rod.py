"""Chains of modules that stand for an extensible rod, straight when unloaded, that does not shear.

A rod of length L with axial stiffness EA, bending stiffness EI, mass rho A and moment of inertia
rho I per length is cut into N elements of length h = L/N. Each becomes a slide and a hinge:

- layout `paper`: module i is element i, and its hinge, its mass and its inertia stand at its end.
  First order in h: a small tip load F deflects the tip by F L^3 / (3 EI) (1 - 3/(2N) + 1/(2N^2)).
- layout `centred`: hinge i and mass i stand in the middle of element i. The first module is h/2
  long, and a rigid piece of h/2 leads from the last hinge to the tip. Second order in h where the
  load does not stretch that piece: F L^3 / (3 EI) (1 - 1/(4 N^2)).

Columns of stiffness k at a distance l give a module the axial stiffness 2 k and the bending
stiffness k l^2 / 2, so that k = EA / (2 h) and l = 2 sqrt(EI / EA) for a whole element. The half
element below the first hinge of the centred layout has twice the axial stiffness, while its hinge
bends as those of all elements do: k_1 = EA / h and l_1 = sqrt(2 EI / EA).

A finer chain can be cut into groups as well, see `lumped`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np

from octarm.arm import lagrange
from octarm.arm.parameters import MOST_MODULES, ArmParameters
from octarm.errors import OctarmError, closest
from octarm.units import Range

LAYOUTS = ("paper", "centred")

# What the properties of a rod may be.
PROPERTIES = {
    "length": Range("m", above=0.0, plausible=10.0),
    "EA": Range("N", above=0.0),
    "EI": Range("N m^2", above=0.0),
    "density": Range("kg/m", above=0.0),
    "rotary_inertia": Range("kg m", above=0.0),
    "damping_time": Range("s", at_least=0.0, plausible=1.0),
    "gravity": Range("m/s^2", at_least=0.0),
}
PROFILES = ("EA", "EI", "density", "rotary_inertia")

# A property along the rod: one number, or its values at the base and at the tip, linear between.
Profile = float | tuple[float, float]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Rod:
    """A straight extensible rod; the defaults are the means of the nominal arm.

    EA, EI, density and rotary inertia are numbers, or pairs of their values at the base and at the
    tip, between which they change linearly. Raises OctarmError for what is not positive and finite;
    the last two may be 0.

    Attributes:
        length: L, unloaded [m].
        EA: axial stiffness [N].
        EI: bending stiffness [N m^2].
        density: mass per length, rho A [kg/m].
        rotary_inertia: moment of inertia per length, rho I [kg m].
        damping_time: ratio of damping to stiffness [s].
        gravity: along the hanging rod [m/s^2].
    """

    length: float = 0.36
    EA: Profile = 240.0
    EI: Profile = 0.384
    density: Profile = 0.75 / 0.36
    rotary_inertia: Profile = 1.5e-3 / 0.45
    damping_time: float = 0.01
    gravity: float = 9.81

    def __post_init__(self) -> None:
        for name, kind in PROPERTIES.items():
            values = np.atleast_1d(np.asarray(getattr(self, name), dtype=np.float64))
            ends = 2 if name in PROFILES else 1
            if values.ndim != 1 or values.size > ends:
                raise OctarmError(
                    f"{name} of a rod has shape {values.shape}; it must be a number"
                    + (" or a pair, at the base and at the tip" if ends == 2 else "")
                )
            good = np.isfinite(values) & kind.allows(values)
            if not good.all():
                allowed = "at least 0" if np.isinf(kind.above) else "above 0"
                raise OctarmError(
                    f"{name} holds {values[~good][0]:g}; it must be finite and {allowed}"
                )

    def at(self, profile: Profile) -> Callable[[float], float]:
        """A property as a function of the unloaded distance from the base [m]."""
        base, tip = np.broadcast_to(profile, 2)
        return lambda x: base + (tip - base) * (x / self.length)


def check_layout(name: str) -> None:
    """Raises OctarmError unless it is one of `LAYOUTS`."""
    if name not in LAYOUTS:
        raise OctarmError(f"unknown layout {name!r}{closest(name, LAYOUTS)}")


def arm_from_rod(rod: Rod, modules: int, layout: str = "paper") -> ArmParameters:
    """The chain of N modules, 1 to 100, that stands for a rod in a layout; see this module.

    Both columns of a module are alike; widths differ between modules where the rod tapers, and
    where the layout is `centred`. Raises OctarmError for another layout or number of modules.
    """
    check_layout(layout)
    if not 1 <= modules <= MOST_MODULES:
        most = f"1 to {MOST_MODULES}"
        raise OctarmError(f"a rod was to be cut into {modules} modules; it must be {most}")
    h = rod.length / modules
    borders = np.linspace(0.0, rod.length, modules + 1)
    axial = h / _integrals(rod, rod.EA, borders, -1)  # springs in series: compliances add
    bending = h / _integrals(rod, rod.EI, borders, -1)
    mass = _integrals(rod, rod.density, borders, 1)
    inertia = _integrals(rod, rod.rotary_inertia, borders, 1)
    rest, tip = np.full(modules, h), 0.0
    slide = axial / h  # axial stiffness of a slide [N/m]
    if layout == "centred":
        middles = np.concatenate([[0.0], 0.5 * (borders[1:] + borders[:-1]), [rod.length]])
        rest, tip = np.diff(middles)[:-1], 0.5 * h
        slide = 1.0 / _integrals(rod, rod.EA, middles, -1)[:-1]
        # A plate turns with the half elements on both sides of it; the base holds the first half.
        inertia = _integrals(rod, rod.rotary_inertia, middles, 1)[1:]
    stiffness = np.broadcast_to(0.5 * slide, (2, modules))
    return ArmParameters(
        mass=mass,
        inertia=inertia,
        width=2.0 * np.sqrt(bending / h / slide),
        stiffness=stiffness,
        damping=rod.damping_time * stiffness,
        rest_length=rest,
        gravity=rod.gravity,
        tip_length=tip,
    )


def _integrals(rod: Rod, profile: Profile, borders: np.ndarray, power: int) -> np.ndarray:
    """Integrals of a property, or of its inverse, between borders [m], by 8 Gauss points each."""
    nodes, weights = np.polynomial.legendre.leggauss(8)
    half = 0.5 * np.diff(borders)[:, None]
    x = borders[:-1, None] + half * (1.0 + nodes)
    values = np.vectorize(rod.at(profile))(x) ** power
    return np.sum(half * weights * values, axis=-1)


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
    tapering it makes that of `arm_from_rod` in the layout `paper`, up to what the rigid piece does
    not stretch. The input range is that of the plant if it is one for all columns, else none.

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

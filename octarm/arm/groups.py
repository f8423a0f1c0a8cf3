"""A plant of more modules than its controller's model, and what is measured and moved of it.

The arm of M modules, which a controller knows, stands for a rod whose properties are the same
within a module. The plant is a chain of N = n M modules of that rod, n to a group, in one of the
layouts of `octarm.arm.rod`. Or the plant is given, and the arm of M modules has the sums of its
groups, see `octarm.arm.rod.lumped`. For coordinates q_N of the plant the controller is given

    q_M = B q_N + offset,    v_M = B v_N

the sums over the groups. In the layout `centred` a slide leads from the middle of an element to the
middle of the next one, so that half of it counts for the group on either side of a border:

    s_1 = s_(1) + .. + s_(n) + s_(n+1)/2
    s_2 = s_(n+1)/2 + s_(n+2) + .. + s_(2n) + s_(2n+1)/2, and so on

and the rigid piece beyond the last hinge belongs to the last group. `offset` makes the lengths of
the unloaded groups those of the modules: half an element for the last one.

Forces act on the plant by virtual work: Q_M does the work Q_M^T v_M, hence Q_N = B^T Q_M, which is
a tension and a moment through each group, one muscle on each side. Input forces give
Q_N = B^T F_coeff(q_M) tau. The motors on the columns of the plant exert it exactly.

What is read of q_M are these sums, or what plates between groups say, see `octarm.arm.plates`.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from octarm.arm.kinematics import last_axis, tip
from octarm.arm.parameters import MOST_MODULES, ArmParameters
from octarm.arm.rod import LAYOUTS, check_layout, group_sums, lumped
from octarm.arrays import added_up, join
from octarm.errors import OctarmError, closest, quoted

PAPER, CENTRED = LAYOUTS
SENSINGS = ("groups", "plates")  # what is read: sums over groups, or arcs between their plates
SUMS, PLATES = SENSINGS

# Of a matrix, see `_rows`.
_Rows = int | Sequence[tuple[slice | np.ndarray, np.ndarray | None]]


@dataclasses.dataclass(frozen=True, eq=False)
class Groups:
    """A plant of N modules in M groups; see this module.

    Attributes:
        arm: the arm of M modules that the groups stand for.
        plant: the chain of N modules, of one arm or of the batch that `arm` is.
        layout: of the chain, `paper` or `centred`.
        matrix: B, shape (2M, 2N) [1].
        offset: shape (..., 2M) [m], [rad].
        sensing: what is read of q_M, one of `SENSINGS`.
    """

    arm: ArmParameters
    plant: ArmParameters
    layout: str
    matrix: np.ndarray
    offset: np.ndarray
    sensing: str = SUMS

    @classmethod
    def of(
        cls, arm: ArmParameters, modules: int, layout: str = PAPER, sensing: str = SUMS
    ) -> Groups:
        """The plant of N modules, in a layout, that the arm of M stands for.

        Its batch axes are the arm's. Raises OctarmError for another layout or sensing, or an N that
        is no multiple of M up to 100.
        """
        check_layout(layout)
        groups = arm.modules
        if not groups <= modules <= MOST_MODULES or modules % groups:
            raise OctarmError(
                f"the plant is to have {modules} modules; it must be a multiple of the arm's "
                f"{groups}, at most {MOST_MODULES}"
            )
        n = modules // groups
        plant = _elements(arm, n) if layout == PAPER else _centred(_elements(arm, n))
        return cls.around(plant, arm, layout, sensing)

    @classmethod
    def around(
        cls, plant: ArmParameters, arm: ArmParameters, layout: str, sensing: str = SUMS
    ) -> Groups:
        """The groups of a plant that the modules of an arm are; raises OctarmError likewise."""
        if sensing not in SENSINGS:
            raise OctarmError(f"unknown sensing {quoted(sensing)}{closest(sensing, SENSINGS)}")
        groups = arm.modules
        slides, sums = group_sums(groups, plant.modules // groups, halved=layout == CENTRED)
        none = np.zeros_like(sums)
        matrix = np.block([[slides, none], [none, sums]])
        offset = np.zeros((*arm.rest_length.shape[:-1], 2 * groups))
        if layout == CENTRED:
            sums_of_rest = _product(_rows(slides), plant.rest_length)
            offset[..., :groups] = arm.rest_length - sums_of_rest
        return cls(arm, plant, layout, matrix, offset, sensing)

    def measured(self, q: np.ndarray) -> np.ndarray:
        """q_M of the plant's coordinates, shapes (..., 2M) and (..., 2N) [m], [rad]."""
        return _product(self._sums, q) + self.offset

    def rates(self, v: np.ndarray) -> np.ndarray:
        """v_M of the plant's velocities, shapes (..., 2M) and (..., 2N) [m/s], [rad/s]."""
        return _product(self._sums, v)

    def along(self, lengths: np.ndarray) -> np.ndarray:
        """What each group has of lengths along the slides, shapes (..., M) and (..., N) [m]."""
        return _product(self._slides, lengths)

    def spread(self, change: np.ndarray) -> np.ndarray:
        """The least change of q_N that changes q_M so, shapes (..., 2N) and (..., 2M)."""
        return _product(_rows(np.linalg.pinv(self.matrix)), change)

    def force(self, force: np.ndarray) -> np.ndarray:
        """Q_N = B^T Q_M, shapes (..., 2N) and (..., 2M) [N], [N m]."""
        return _product(self._shares, force)

    def mean_force(self, force: np.ndarray) -> np.ndarray:
        """The Q_M whose B^T Q_M is nearest to a force on the plant, shape (..., 2M) [N], [N m].

        It is the inverse of `force`: in the paper's layout, the mean over each group.
        """
        return _product(self._means, force)

    def ctrl(self, force: np.ndarray) -> np.ndarray:
        """`ctrl` of the plant's model that exerts B^T Q_M, shape (..., 4N - 2) [N]."""
        n, on_plant = self.plant.modules, self.force(force)
        push, couple = 0.5 * on_plant[..., :n], on_plant[..., n:] / self.plant.widths
        out = np.zeros_like(on_plant, shape=(*on_plant.shape[:-1], 4 * n - 2))
        out[..., 0 : 2 * n : 2], out[..., 1 : 2 * n : 2] = push + couple, push - couple
        return out

    def tip(self, q: np.ndarray) -> np.ndarray:
        """The end of the last group, given q_N of shape (..., 2N), shape (..., 2) [m].

        In the base frame: x along the hanging arm, y across it.
        """
        (x, y), (cos, sin) = tip(q), last_axis(q)
        return join([x + self._beyond * cos, y + self._beyond * sin], q[..., :2])

    def each_module(self, values: np.ndarray) -> np.ndarray:
        """Values of the arm's modules, shape (..., M), for those of the plant, shape (..., N)."""
        return np.repeat(values, self.plant.modules // self.arm.modules, axis=-1)

    @functools.cached_property
    def beyond(self) -> np.ndarray:
        """How far each group's plate is from where `along` ends, shape (..., M) [m].

        In the layout `centred` the last one ends with the rigid piece behind the last hinge.
        """
        return np.cumsum(self.offset[..., : self.arm.modules], axis=-1)

    @functools.cached_property
    def _sums(self) -> _Rows:
        return _rows(self.matrix)

    @functools.cached_property
    def _slides(self) -> _Rows:
        return _rows(self.matrix[: self.arm.modules, : self.plant.modules])

    @functools.cached_property
    def _shares(self) -> _Rows:
        return _rows(self.matrix.T)

    @functools.cached_property
    def _means(self) -> _Rows:
        return _rows(np.linalg.pinv(self.matrix.T))

    @functools.cached_property
    def _beyond(self) -> np.ndarray:
        """The rigid piece that belongs to the last group, shape (...) [m]."""
        return self.plant.tip_length - self.arm.tip_length


def groups_of(
    arm: ArmParameters,
    plant_modules: int | None = None,
    layout: str = PAPER,
    sensing: str = SUMS,
    groups: int | None = None,
) -> Groups | None:
    """The groups of a plant of so many modules, if that is another one than the arm itself.

    Or those of the arm, if it is to be the plant of so many groups. Raises OctarmError if there is
    no such plant, or its layout or its sensing is given without a number of modules.
    """
    if groups is not None and groups != arm.modules:
        if plant_modules is not None or layout != PAPER or arm.batch_shape:
            raise OctarmError(
                f"an arm of {arm.modules} modules, controlled as {groups} groups, is the plant "
                "itself: one arm, without plant_modules or layout"
            )
        ends_rigid = bool(np.any(arm.tip_length))
        plant = dataclasses.replace(arm, input_range=(-np.inf, np.inf))
        return Groups.around(plant, lumped(arm, groups), CENTRED if ends_rigid else PAPER, sensing)
    modules = arm.modules if plant_modules is None else plant_modules
    finer = Groups.of(arm, modules, layout, sensing)
    for name, value, usual in (("layout", layout, PAPER), ("sensing", sensing, SUMS)):
        if plant_modules is None and value != usual:
            raise OctarmError(
                f"{name} is {value!r}, that of a plant of more modules; plant_modules must say of "
                "how many"
            )
    the_arm = modules == arm.modules and (layout, sensing) == (PAPER, SUMS)
    return None if the_arm else finer


def grouped(arm: ArmParameters, model: ArmParameters) -> int | None:
    """In how many groups an arm is controlled for a model; None if their modules are the same.

    Raises OctarmError for a model of groups whose lengths are not those of groups.
    """
    if model.modules == arm.modules:
        return None
    if np.any(model.tip_length):
        raise OctarmError(
            "the model ends with a rigid piece, as in the layout centred, so that its modules are "
            "not groups of the arm's; one in the layout paper is needed"
        )
    return model.modules


def _elements(arm: ArmParameters, n: int) -> ArmParameters:
    """Every module cut into n alike ones in a row, which share its mass and its compliance.

    The inverse of `octarm.arm.rod.arm_from_rod` in the paper's layout, for a rod whose properties
    are the same within a module: rho A = m / L, rho I = I / L, EA = (k_1 + k_2) L and
    EI = EA l^2 / 4 for a module of length L.
    """
    shared = {name: np.repeat(getattr(arm, name) / n, n, axis=-1) for name in _SHARED}
    stiffer = {name: np.repeat(getattr(arm, name) * n, n, axis=-1) for name in _IN_SERIES}
    width = np.repeat(arm.widths, n, axis=-1)
    return dataclasses.replace(arm, **shared, **stiffer, width=width, input_range=(-np.inf, np.inf))


_SHARED = ("mass", "inertia", "rest_length", "rest_angle")
_IN_SERIES = ("stiffness", "damping", "backbone_stiffness", "backbone_damping")


def _centred(p: ArmParameters) -> ArmParameters:
    """The layout `centred` of elements that are given as modules in the paper's layout.

    A slide has the compliance of the half elements on both sides of a border, a hinge that of its
    own element. Where elements differ, dampers combine like springs: exact if all have the same
    ratio of damping to stiffness.
    """
    rest, slide, damper = p.rest_length.copy(), 2.0 * p.stiffness, 2.0 * p.damping
    rest[..., 1:] = 0.5 * (p.rest_length[..., :-1] + p.rest_length[..., 1:])
    rest[..., 0] *= 0.5
    slide[..., 1:], damper[..., 1:] = _in_series(slide), _in_series(damper)
    backbone = {
        name: getattr(p, name).copy() for name in ("backbone_stiffness", "backbone_damping")
    }
    for each in backbone.values():  # bending belongs to an element, as does that of the columns
        along = 2.0 * each[..., :1, :]
        each[..., :1, :], each[..., :1, 1:] = along, _in_series(along)
    inertia = 0.5 * p.inertia  # a plate turns with the half elements on both sides of it
    inertia[..., :-1] += 0.5 * p.inertia[..., 1:]
    bending = np.sum(p.stiffness, axis=-2) / np.sum(slide, axis=-2)
    return dataclasses.replace(
        p,
        rest_length=rest,
        stiffness=slide,
        damping=damper,
        inertia=inertia,
        width=p.widths * np.sqrt(bending),
        **backbone,
        tip_length=p.tip_length + 0.5 * p.rest_length[..., -1],
    )


def _in_series(halves: np.ndarray) -> np.ndarray:
    """Springs or dampers of half elements, each in series with the next, shape (..., N - 1)."""
    first, second = halves[..., :-1], halves[..., 1:]
    both = first + second
    return np.where(both > 0.0, first * second / np.where(both > 0.0, both, 1.0), 0.0)


def _rows(matrix: np.ndarray) -> _Rows:
    """The k-th entry of every row that is not zero, for each k: columns, and weights of shape (k,).

    Columns that are evenly spaced are a slice, which costs no copy. Weights are None if all are 1;
    a row that has fewer entries than others ends with weights of 0. A number n stands for the sums
    of n neighbours each.
    """
    n = matrix.shape[1] // len(matrix)
    if n and np.array_equal(matrix, np.repeat(np.eye(len(matrix)), n, axis=1)):
        return n
    entries = [np.flatnonzero(np.abs(row) > 1e-12) for row in matrix]
    parts: list[tuple[slice | np.ndarray, np.ndarray | None]] = []
    for k in range(max(map(len, entries))):
        columns = np.array([row[k] if k < len(row) else row[0] for row in entries])
        there = np.array([k < len(row) for row in entries])
        weights = np.where(there, matrix[np.arange(len(matrix)), columns], 0.0)
        step = columns[1] - columns[0]
        even = step > 0 and np.all(np.diff(columns) == step)
        place = slice(columns[0], columns[-1] + 1, step) if even else columns
        parts.append((place, None if np.all(weights == 1.0) else weights))
    return parts


def _product(rows: _Rows, x: np.ndarray) -> np.ndarray:
    """A matrix times x, elementwise along the batch and added up in order, shape (..., k)."""
    along, parts = x.T, list[np.ndarray]()
    if isinstance(rows, int):
        blocks = along.reshape(-1, rows, *(along.shape[1:] or (1,)))
        parts = [added_up(blocks, 1).reshape(-1, *along.shape[1:])]
    for columns, weights in () if isinstance(rows, int) else rows:
        part = along[columns]
        if weights is not None:
            factor = weights.reshape(-1, *[1] * (x.ndim - 1))
            part = np.where(factor == 0.0, 0.0, part) * factor  # where x is infinite, too
        parts.append(part)
    total = functools.reduce(np.add, parts)
    out = np.empty_like(x, shape=(*x.shape[:-1], len(total)))
    np.add(total, 0.0, out=out.T)  # so that there is no -0
    return out

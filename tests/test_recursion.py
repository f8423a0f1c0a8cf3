"""A recursion gives the same bits for one arm, for a batch, and compiled."""
# pyright: reportAttributeAccessIssue=false

import sys
from collections.abc import Sequence
from typing import Literal

import numpy as np
import pytest

from octarm.arm.actuation import ACTUATIONS
from octarm.arm.lagrange import inverse_dynamics, kinetic_energy
from octarm.arm.parameters import ArmParameters
from octarm.arm.rod import Rod, arm_from_rod

numba = pytest.importorskip("numba")
ARMS = 7
BACKBONE = {
    "backbone_stiffness": [[3.0] * 3, [0.1] * 3],
    "backbone_damping": [[0.3] * 3, [0.01] * 3],
    "rest_angle": [0.1, -0.2, 0.3],
}


def arm(kind: str) -> ArmParameters:
    three = arm_from_rod(Rod(), 3)
    if kind == "backbone":
        return ArmParameters(**{**three.to_dict(), **BACKBONE})
    if kind == "each its own":
        return three.mismatched(np.linspace(-0.3, 0.3, ARMS))
    return arm_from_rod(Rod(), int(kind))


def results(p: ArmParameters, arrays: Sequence[np.ndarray]) -> list[np.ndarray]:
    q, v, a, v_r, force = arrays
    both = [made(p.widths) for made in ACTUATIONS.values()]
    forces = [x for one in both for x in (one.inputs(q, force), one.force(q, force))]
    return [inverse_dynamics(p, q, v, a, v_r), kinetic_energy(p, q, v), *forces]


@pytest.mark.parametrize("order", ["C", "F"])
@pytest.mark.parametrize("kind", ["1", "3", "15", "backbone", "each its own"])
def test_all_ways_give_the_same_bits(
    kind: str, order: Literal["C", "F"], monkeypatch: pytest.MonkeyPatch
):
    p = arm(kind)
    drawn = np.random.default_rng(0).normal(scale=0.3, size=(5, ARMS, p.coordinates))
    drawn[1, 2, 0], drawn[2, 3, -1] = np.inf, np.nan  # an arm that is lost may hold anything
    arrays = [np.array(x, order=order) for x in drawn]
    with np.errstate(all="ignore"):
        compiled = results(p, arrays)
        monkeypatch.delitem(sys.modules, "numba")
        plain = results(p, arrays)
        alone = [
            results(p.arm(i) if p.batch_shape else p, [x[i] for x in arrays]) for i in range(ARMS)
        ]
    for way in (plain, [np.stack(rows) for rows in zip(*alone, strict=True)]):
        for one, other in zip(compiled, way, strict=True):
            np.testing.assert_array_equal(one, other)


def test_other_kinds_of_numbers_are_not_compiled():
    """A complex step, as the tests of the model take, keeps its imaginary part."""
    p, h = arm("3"), 1e-30
    q = np.full((2, 6), 0.1) + 1j * h
    slope = inverse_dynamics(p, q, 0.0 * q, 0.0 * q).imag / h
    assert np.all(np.abs(slope[:, 3:]) > 0.0)

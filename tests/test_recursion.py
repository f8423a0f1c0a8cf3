"""A recursion gives the same bits for one arm, for a batch, and compiled."""
# pyright: reportAttributeAccessIssue=false

import contextlib
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Any, Literal

import numpy as np
import pytest

from octarm.arm.actuation import ACTUATIONS
from octarm.arm.lagrange import inverse_dynamics, kinetic_energy, potential_hessian
from octarm.arm.parameters import ArmParameters
from octarm.arm.recursion import kept
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
            known = ~np.isnan(one)
            np.testing.assert_array_equal(np.signbit(one[known]), np.signbit(other[known]))


def test_other_kinds_of_numbers_are_not_compiled():
    """A complex step gives the slope of one arm and of a batch, which at rest is the stiffness."""
    p, h = arm("3"), 1e-30
    q = np.linspace(0.05, 0.3, 6) + 1j * h
    still = 0.0 * q
    one = inverse_dynamics(p, q, still, still).imag / h
    np.testing.assert_allclose(one, potential_hessian(p, q.real) @ np.ones(6))
    both = inverse_dynamics(p, np.stack([q, q]), still, still).imag / h
    np.testing.assert_array_equal(both, [one, one])
    for actuation in (made(p.widths) for made in ACTUATIONS.values()):
        ends = [actuation.force(q.real + sign * 1e-6, np.arange(6.0)) for sign in (1.0, -1.0)]
        slope = actuation.force(q, np.arange(6.0)).imag / h
        np.testing.assert_allclose(slope, (ends[0] - ends[1]) / 2e-6, atol=1e-8)


def test_the_kind_of_numbers_is_that_of_the_call():
    """Not that of an earlier one at the same place."""
    p, q = arm("3"), np.linspace(0.05, 0.3, 6)
    for x in (q + 0j, q, q + 0j):
        assert inverse_dynamics(p, x, x, x).dtype == x.dtype
    single = q.astype(np.float32)
    for x in (single, np.stack([single, single])):
        assert inverse_dynamics(p, x, x, x).dtype == np.float64


def test_without_a_place_for_it_compiled_code_is_not_kept():
    def compiler(*, cache: bool = False) -> Callable[[Any], Any]:
        if cache:
            raise RuntimeError("no locator available")
        return lambda function: (function, "compiled")

    assert kept(compiler, arm) == (arm, "compiled")


def test_who_compiles_what_is_kept_waits_for_the_others(monkeypatch: pytest.MonkeyPatch, tmp_path):
    """Or files of one process would stand beside those of another, which they do not fit."""
    monkeypatch.setattr("numba.core.config.CACHE_DIR", str(tmp_path))
    both, together = threading.Barrier(2), list[bool]()

    def compiler(*, cache: bool = False) -> Callable[[Any], Any]:
        assert cache
        with contextlib.suppress(threading.BrokenBarrierError):
            both.wait(0.3)
            together.append(True)
        return lambda function: function

    threads = [threading.Thread(target=kept, args=(compiler, arm)) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not together
    assert list(tmp_path.rglob("*.lock"))

"""Which entries of the paper's eqs (2)-(5) are misprinted, and that the code has the right ones."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import errata
import numpy as np
import pytest
import sympy as sp
from errata import CORRECTIONS, Matrix, corrected, differing_entries

from octarm import ArmParameters
from octarm.arm import lagrange

ZERO = sp.zeros(6, 6)
PAIRS = {
    "F_coeff": (errata.printed_force_coefficients, errata.derived_force_coefficients),
    "D": (errata.printed_mass_matrix, errata.derived_mass_matrix),
    "C": (errata.printed_rate_matrix, errata.rate_matrix_in_paper_layout),
    "G": (errata.printed_potential_force, errata.derived_potential_force),
}


def random_arm(rng: np.random.Generator) -> ArmParameters:
    return ArmParameters(
        mass=rng.uniform(0.1, 0.4, 3),
        inertia=rng.uniform(2e-4, 9e-4, 3),
        width=rng.uniform(0.05, 0.12),
        stiffness=rng.uniform(500, 1500, (2, 3)),
        damping=rng.uniform(2, 15, (2, 3)),
        rest_length=rng.uniform(0.08, 0.15, 3),
        gravity=rng.uniform(5, 12),
    )


def random_state(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    q = np.concatenate([rng.uniform(0.04, 0.25, 3), rng.uniform(-1.5, 1.5, 3)])
    return q, rng.uniform(-1, 1, 6) * np.repeat([0.5, 6.0], 3)


def derived_function(matrix: Matrix) -> Callable[..., np.ndarray]:
    compiled = sp.lambdify([errata.PARAMETERS, errata.q, errata.v], matrix, "numpy")

    def function(p: ArmParameters, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        columns = (*p.stiffness, *p.damping)
        flat = np.hstack([p.mass, p.inertia, p.width[0], *columns, p.rest_length, p.gravity])
        return compiled(flat, q, v).squeeze()

    return function


@pytest.mark.parametrize(
    ("name", "wrong"),
    [
        ("F_coeff", set()),
        ("D", {(1, 5), (3, 4), (5, 4)}),
        (
            "C",
            {
                *[(1, 4), (1, 5), (2, 4), (2, 5), (3, 4), (3, 6)],
                *[(4, 1), (4, 2), (4, 3), (4, 4), (4, 5), (5, 2)],
            },
        ),
        ("G", set()),
    ],
)
def test_exactly_these_printed_entries_are_wrong(name: str, wrong: set[tuple[int, int]]):
    printed, derived = PAIRS[name]
    assert differing_entries(printed(), derived()) == wrong == set(CORRECTIONS[name])


@pytest.mark.parametrize("name", PAIRS)
def test_corrections_turn_the_printed_matrix_into_the_derived_one(name: str):
    printed, derived = PAIRS[name]
    assert differing_entries(corrected(printed(), CORRECTIONS[name]), derived()) == set()


def test_a_corrected_layout_gives_the_derived_velocity_force():
    c = corrected(errata.printed_rate_matrix(), CORRECTIONS["C"])
    rates = sp.Matrix(errata.v)
    expected = errata.derived_velocity_force() + errata.derived_damping() * rates
    assert differing_entries(c * rates, expected) == set()


def test_no_other_placement_of_the_mixed_products_excuses_an_entry_of_c():
    """theta_1' theta_2' may stand in either column of a row: 16 layouts, none with fewer errors."""
    printed = errata.printed_rate_matrix()
    for rows in itertools.product((3, 4), repeat=4):
        layout = errata.rate_matrix_in_paper_layout((*rows, 4, 4))
        assert differing_entries(printed, layout) >= set(CORRECTIONS["C"])


def test_derived_mass_matrix_is_symmetric_as_a_whole():
    d = errata.derived_mass_matrix()
    assert differing_entries(d, d.T) == set()


def test_christoffel_form_gives_the_derived_velocity_force():
    c = errata.derived_christoffel()
    assert differing_entries(c * sp.Matrix(errata.v), errata.derived_velocity_force()) == set()


def skew_defect(c: Matrix) -> Matrix:
    """N + N^T for N = D' - 2C: zero if and only if x^T N x = 0 for every x."""
    n = errata.derived_mass_matrix().applyfunc(errata.rate) - 2 * c
    return n + n.T


def test_christoffel_form_makes_the_rate_of_d_minus_twice_c_skew():
    assert differing_entries(skew_defect(errata.derived_christoffel()), ZERO) == set()


def test_damping_inside_c_leaves_minus_four_b_in_the_symmetric_part():
    b = errata.derived_damping()
    defect = skew_defect(errata.derived_christoffel() + b)
    assert differing_entries(defect, -4 * b) == set()


def test_the_papers_layout_is_not_skew_even_when_corrected():
    c = errata.rate_matrix_in_paper_layout() - errata.derived_damping()
    upper = {(i, j) for i, j in differing_entries(skew_defect(c), ZERO) if i <= j}
    assert upper == {
        *[(1, 2), (1, 3), (1, 4), (1, 5)],
        *[(2, 3), (2, 4), (2, 5)],
        *[(3, 4), (3, 5)],
        *[(4, 4), (4, 5), (5, 5)],
    }


def test_every_c_with_the_right_vector_conserves_power_along_the_motion():
    rates = sp.Matrix(errata.v)
    c = errata.rate_matrix_in_paper_layout() - errata.derived_damping()
    assert errata.tidy((rates.T * skew_defect(c) * rates)[0]) == 0


def test_the_literal_mass_matrix_is_indefinite_in_a_tenth_of_the_working_range():
    rng = np.random.default_rng(1)
    slides, bends = rng.uniform(0.06, 0.2, (2000, 3)), rng.uniform(-1.2, 1.2, (2000, 3))
    arm = ArmParameters(
        mass=[0.30, 0.25, 0.20],
        inertia=[6e-4, 5e-4, 4e-4],
        width=0.08,
        stiffness=[[1200, 1000, 800]] * 2,
        damping=[[12, 10, 8]] * 2,
        rest_length=[0.12] * 3,
        gravity=9.81,
    )
    smallest = {}
    for name, matrix in (
        ("printed", errata.printed_mass_matrix().subs(errata.stray, 1)),
        ("derived", errata.derived_mass_matrix()),
    ):
        function = derived_function(matrix)
        d = np.stack([function(arm, q, 0 * q) for q in np.hstack([slides, bends])])
        smallest[name] = np.linalg.eigvalsh(0.5 * (d + np.swapaxes(d, -1, -2)))[:, 0]
    assert 0.08 < np.mean(smallest["printed"] < 0.0) < 0.12
    assert np.min(smallest["derived"]) > 0.0


@pytest.mark.parametrize(
    ("derive", "coded"),
    [
        (errata.derived_mass_matrix, lambda p, q, v: lagrange.mass_matrix(p, q)),
        (errata.derived_christoffel, lagrange.coriolis_matrix),
        (errata.derived_damping, lambda p, q, v: lagrange.damping_matrix(p)),
        (errata.derived_potential_force, lambda p, q, v: lagrange.potential_force(p, q)),
        (errata.derived_force_coefficients, lambda p, q, v: lagrange.force_coefficients(p, q)),
        (
            lambda: (
                errata.derived_velocity_force()
                + errata.derived_damping() * sp.Matrix(errata.v)
                + errata.derived_potential_force()
            ),
            lambda p, q, v: lagrange.inverse_dynamics(p, q, v, 0 * q),
        ),
    ],
    ids=["D", "C", "B", "G", "F_coeff", "h+Bv+G"],
)
def test_the_code_computes_what_sympy_derives(derive: Callable, coded: Callable):
    rng = np.random.default_rng(2)
    derived = derived_function(derive())
    for _ in range(50):
        p = random_arm(rng)
        q, v = random_state(rng)
        expected = derived(p, q, v)
        tolerance = 1e-12 * np.max(np.abs(expected))
        np.testing.assert_allclose(coded(p, q, v), expected, rtol=0, atol=tolerance)


def test_the_coded_christoffel_form_is_skew_for_arbitrary_vectors():
    rng = np.random.default_rng(3)
    d_rate = derived_function(errata.derived_mass_matrix().applyfunc(errata.rate))
    for _ in range(50):
        p = random_arm(rng)
        q, v = random_state(rng)
        n = d_rate(p, q, v) - 2 * lagrange.coriolis_matrix(p, q, v)
        x = rng.normal(size=6)
        assert abs(x @ n @ x) < 1e-13 * np.linalg.norm(n) * (x @ x)

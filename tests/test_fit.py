"""Chains of few modules fitted to finer ones."""

import dataclasses

import numpy as np
import pytest
from scipy.linalg import expm

from octarm.arm import lagrange
from octarm.arm.file import read_arm
from octarm.arm.fit import behaviour_of, fit_modules
from octarm.arm.kinematics import tip_force, tip_position
from octarm.arm.modes import state_matrix
from octarm.arm.parameters import ArmParameters
from octarm.arm.rod import LAYOUTS, Rod, arm_from_rod, lumped
from octarm.checks import rod_study
from octarm.commands import cli
from octarm.errors import OctarmError

ROD = Rod()
FIELDS = ("mass", "inertia", "widths", "stiffness", "damping", "rest_length", "tip_length")


def assert_alike(one: ArmParameters, other: ArmParameters, rtol: float):
    for name in FIELDS:
        a, b = getattr(one, name), getattr(other, name)
        np.testing.assert_allclose(a, np.broadcast_to(b, a.shape), rtol=rtol, err_msg=name)


def uneven(modules: int, tip: float = 0.0) -> ArmParameters:
    """A chain in which no two modules and columns are alike."""
    p, rng = arm_from_rod(ROD, modules), np.random.default_rng(5)
    factors = {
        name: np.exp(rng.uniform(-0.3, 0.3, np.shape(getattr(p, name))))
        for name in ("mass", "inertia", "width", "stiffness", "damping", "rest_length")
    }
    return dataclasses.replace(p.scaled(**factors), tip_length=tip)


@pytest.mark.parametrize("size", [1, 2, 5])
def test_a_uniform_rod_s_chain_lumps_to_the_chain_of_fewer_modules(size: int):
    p = arm_from_rod(ROD, 3 * size)
    for layout in LAYOUTS:
        assert_alike(lumped(p, 3, layout), arm_from_rod(ROD, 3, layout), 1e-12)


def test_lumping_keeps_mass_length_and_compliances():
    for tip in (0.0, 0.02):
        p = uneven(6, tip)
        for layout in LAYOUTS:
            few = lumped(p, 2, layout)
            total = [np.sum(x.rest_length) + x.tip_length for x in (p, few)]
            np.testing.assert_allclose(total[1], total[0], rtol=1e-14)
            np.testing.assert_allclose(np.sum(few.mass), np.sum(p.mass), rtol=1e-14)
            bends = [np.sum(4.0 / (x.widths**2 * np.sum(x.stiffness, 0))) for x in (p, few)]
            np.testing.assert_allclose(bends[1], bends[0], rtol=1e-14)
    give = [np.sum(1.0 / np.sum(x.stiffness, 0)) for x in (uneven(6), lumped(uneven(6), 3))]
    np.testing.assert_allclose(give[1], give[0], rtol=1e-14)
    assert np.all(lumped(uneven(6).scaled(damping=0.0), 3).damping == 0.0)


def placed(p: ArmParameters, q: np.ndarray, groups: int) -> np.ndarray:
    """What `Behaviour` calls outputs, at q."""
    y, _, z = tip_position(q, p.entries.tip_length)
    n = p.modules
    plates = np.cumsum(q[n:])[n // groups - 1 :: n // groups]
    return np.array([-z, y, *plates])


@pytest.mark.parametrize("tip", [0.0, 0.03])
def test_compliances_are_the_slopes_of_the_loaded_equilibrium(tip: float):
    p, groups, h = uneven(4, tip), 2, 1e-4
    still = lagrange.equilibrium(p)
    b = p.entries.tip_length

    def loaded(load: int, size: float) -> np.ndarray:
        def balance(q: np.ndarray):
            force = np.zeros_like(q)
            if load < 2:
                force = tip_force(q, size * (load == 0), size * (load == 1), b)
            else:
                force[4 : 4 + 2 * (load - 1)] = size
            return lagrange.potential_force(p, q) - force, lagrange.potential_hessian(p, q)

        return placed(p, lagrange.newton(balance, still, 1e-13), groups)

    slopes = [(loaded(j, h) - loaded(j, -h)) / (2.0 * h) for j in range(2 + groups)]
    compliance = behaviour_of(p, groups, np.ones(1)).compliance
    np.testing.assert_allclose(compliance, compliance.T, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(compliance, np.array(slopes).T, rtol=1e-6, atol=1e-8)


def test_the_sag_under_weight_is_that_of_gravity_turned_by_a_little():
    p = dataclasses.replace(arm_from_rod(ROD, 6), gravity=0.0)
    g = 1e-4
    across = rod_study.static_tip(p, np.zeros(2), np.array([0.0, g]))
    along = rod_study.static_tip(p, np.zeros(2), np.array([g, 0.0]))
    weight = behaviour_of(p, 3, np.ones(1)).weight * g / 9.81
    np.testing.assert_allclose(weight[0], along[0] - ROD.length, rtol=1e-6)
    np.testing.assert_allclose(weight[[1, -1]], across[1:], rtol=1e-6)


def test_responses_are_those_of_the_matrix_exponential():
    p, times = uneven(3), np.array([0.03, 0.4])
    q = lagrange.equilibrium(p)
    state, load = state_matrix(p, q), tip_force(q, 0.0, 1.0)
    push = np.concatenate([np.zeros(6), np.linalg.solve(lagrange.mass_matrix(p, q), load)])
    steady = np.linalg.solve(state, push)
    moved = [load @ (expm(state * t) @ steady - steady)[:6] for t in times]
    behaviour = behaviour_of(p, 3, times)
    np.testing.assert_allclose(behaviour.response[1], moved, rtol=1e-9)
    late = behaviour_of(p, 3, np.array([1e3]))
    np.testing.assert_allclose(late.response[:, 0], late.finals, rtol=1e-9)


def test_modes_are_those_of_bending_and_of_stretching():
    p = dataclasses.replace(arm_from_rod(ROD, 6), gravity=0.0)
    bending, axial = rod_study.frequencies(p)
    found = behaviour_of(p, 3, np.ones(1)).frequencies
    np.testing.assert_allclose(found, [*bending[:2], axial[0]], rtol=1e-9)


def test_a_chain_is_its_own_best_fit():
    fit = fit_modules(uneven(3))
    assert_alike(fit.parameters, uneven(3), 1e-9)
    for kind in ("statics", "modes", "transient"):
        assert max(fit.rms(kind)) < 1e-9


@pytest.fixture(scope="module")
def fits():
    return {layout: fit_modules(ROD, 3, layout) for layout in LAYOUTS}


def test_fitted_parameters_are_admissible_and_the_lengths_stay(fits):
    for layout, fit in fits.items():
        for name in ("mass", "inertia", "width", "stiffness", "damping"):
            assert np.all(getattr(fit.parameters, name) > 0.0)
        exact = arm_from_rod(ROD, 3, layout)
        np.testing.assert_allclose(fit.parameters.rest_length, exact.rest_length, rtol=1e-12)
        np.testing.assert_allclose(fit.parameters.tip_length, exact.tip_length, rtol=1e-12)


def test_a_fit_with_centred_hinges_leaves_percents_and_one_in_the_paper_s_layout_cannot(fits):
    for kind, before, after in (("statics", 0.05, 0.02), ("modes", 0.03, 0.01)):
        assert fits["centred"].rms(kind)[0] > before
        assert fits["centred"].rms(kind)[1] < after
    assert fits["centred"].rms("transient")[1] < 0.02
    # Hinges at the ends of modules cannot have both the give of the tip under a force and that of
    # the plates under couples: theta_3 does not move the tip.
    assert fits["paper"].rms("statics")[1] > 0.1
    for kind in ("statics", "modes", "transient"):
        before, after = fits["paper"].rms(kind)
        assert after < before


def test_no_nearby_chain_fits_better(fits):
    fit = fits["centred"]
    plant = arm_from_rod(ROD, 30, "centred")
    times = np.linspace(0.0, 3.0, 151)[1:] / behaviour_of(plant, 3, np.ones(1)).frequencies[0]
    right = behaviour_of(plant, 3, times)

    def cost(p: ArmParameters) -> float:
        errors = behaviour_of(p, 3, times).errors(right)
        upper = errors.compliance[np.triu_indices(5)]
        parts = [np.concatenate([upper, errors.weight]), errors.frequencies, errors.response]
        moved = [
            np.log(getattr(p, name) / getattr(fit.start, name)).reshape(-1, 3)[0]
            for name in ("mass", "inertia", "stiffness", "width", "damping")
        ]
        return sum(float(np.mean(x**2)) for x in parts) + 1e-4 * float(np.sum(np.square(moved)))

    best, rng = cost(fit.parameters), np.random.default_rng(8)
    for name in ("mass", "inertia", "stiffness", "width", "damping"):
        for _ in range(4):
            factor = np.exp(0.01 * rng.standard_normal(3))
            assert cost(fit.parameters.scaled(**{name: factor})) > best


def test_the_centred_fit_moves_more_like_the_rod_in_a_release_far_from_where_it_was_made(fits):
    right = rod_study.released(arm_from_rod(ROD, 40, "centred"))[: rod_study.FIRST + 1]
    apart = []
    for p in (fits["centred"].start, fits["centred"].parameters):
        apart.append(rod_study.distance(ROD, rod_study.released(p)[: len(right)], right))
    assert apart[1] < 0.5 * apart[0]


def test_the_report_has_all_quantities_and_parameters(fits):
    text = str(fits["paper"])
    for word in (
        "tip across, force across",
        "bending 2",
        "step of couple 3",
        "statics, rms",
        "width",
    ):
        assert word in text
    assert "nan" not in text


def test_a_fit_of_one_module_and_of_an_undamped_plant_is_made():
    assert len(fit_modules(ROD, 1).parameters.mass) == 1
    undamped = arm_from_rod(dataclasses.replace(ROD, damping_time=0.0), 6)
    assert np.all(fit_modules(undamped, 3).parameters.damping == 0.0)


def test_what_cannot_be_fitted_is_refused():
    with pytest.raises(OctarmError, match=r"4 groups were to be made of 9 modules; .* divide"):
        fit_modules(arm_from_rod(ROD, 9), 4)
    with pytest.raises(OctarmError, match="0 groups"):
        fit_modules(arm_from_rod(ROD, 9), 0)
    with pytest.raises(OctarmError, match=r"'centered'.*centred"):
        fit_modules(ROD, 3, "centered")
    batch = arm_from_rod(ROD, 6).mismatched(np.array([0.0, 0.1]))
    with pytest.raises(OctarmError, match=r"batch axes \(2,\)"):
        fit_modules(batch)
    standing = dataclasses.replace(arm_from_rod(ROD, 6), gravity=-100.0)
    with pytest.raises(OctarmError, match="hang stably"):
        fit_modules(standing)


def test_a_backbone_and_bends_without_force_are_lumped():
    p = arm_from_rod(ROD, 6)
    give = np.diag(lagrange.stiffness_matrix(p))[6:]
    q = dataclasses.replace(
        p,
        rest_angle=np.linspace(0.01, 0.06, 6),
        backbone_stiffness=[np.sum(p.stiffness, axis=0), 3.0 * give],
    )
    few = lumped(q, 3)
    np.testing.assert_allclose(few.rest_angle, [0.03, 0.07, 0.11], rtol=1e-13)
    plain = np.diag(lagrange.stiffness_matrix(lumped(p, 3)))
    expected = plain * np.repeat([2.0, 4.0], 3)
    np.testing.assert_allclose(np.diag(lagrange.stiffness_matrix(few)), expected, rtol=1e-12)


def test_the_command_writes_the_fitted_arm(tmp_path, capsys):
    file = tmp_path / "few.toml"
    words = ["arm", "--from-rod", "modules=9", "--fit-modules", "3", "--write", str(file)]
    assert cli.main(words) == 0
    out = capsys.readouterr().out
    assert "statics, rms of all" in out
    assert "3 modules for a rod of 9 modules" in out
    fit = fit_modules(arm_from_rod(ROD, 9), 3)
    assert_alike(read_arm(file), fit.parameters, 1e-10)  # it has 12 digits
    assert cli.main([*words[:4], "4"]) == 2
    assert "4 groups were to be made of 9 modules" in capsys.readouterr().err

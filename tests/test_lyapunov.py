"""The Lyapunov ledger: right laws pass it, wrong ones do not."""
# pyright: reportAttributeAccessIssue=false, reportArgumentType=false, reportAssignmentType=false

import dataclasses
import json
from collections.abc import Callable

import errata
import numpy as np
import pytest
import sympy as sp

from controllers import (
    CONTROLLERS,
    AdaptiveConsequents,
    AdaptiveFuzzy,
    BoundaryLayer,
    FuzzySlidingMode,
    IntegralSlidingMode,
    SlidingMode,
    SuperTwisting,
    make_controller,
)
from controllers.proofs import adaptive_ledger, lyapunov
from controllers.proofs.ledger import ledger
from controllers.sliding_mode import Surface
from octarm.arm import lagrange
from octarm.arm.mjcf import nominal_parameters
from octarm.checks.validation import arm_with, random_arm
from octarm.commands import cli

P = nominal_parameters()
BARE = P.scaled(damping=0.0)
ADAPTIVE = ("afsmc", "afsmc normalised", "afsmc-consequent", "afsmc-consequent normalised")


def draw(states: int = 500, arm=P):
    rng = np.random.default_rng(1)
    return lyapunov.random_instants(arm, states, rng)


# ------------------------------------------------------------------------------- the ledger


@pytest.mark.parametrize("modules", [1, 2, 3, 5])
def test_every_controller_passes_with_any_number_of_modules(modules: int):
    report = ledger(arm_with(modules), 300)
    assert report.passed, str(report)
    text = json.dumps(report.to_dict(), allow_nan=False)
    assert json.loads(text)["checks"][0]["what"] == "smc: V' - claim"


def test_another_arm_passes():
    report = ledger(random_arm(np.random.default_rng(3), 3), 100)
    assert report.passed, str(report)


def test_the_seed_decides_all_rows():
    assert ledger(P, 100, seed=5).checks == ledger(P, 100, seed=5).checks
    assert ledger(P, 100, seed=6).checks[0] != ledger(P, 100, seed=5).checks[0]


def reports_V(name: str) -> bool:
    at, controller = draw(2), make_controller(name, P)
    command, _ = controller(controller.initial_state((2,)), at.measurement, at.reference)
    return "V" in command.signals


def test_every_controller_that_reports_V_has_its_rows():
    rows = [check.what for check in ledger(P, 100).checks]
    names = set(filter(reports_V, CONTROLLERS))
    assert names == set(CONTROLLERS) - {"pd", "computed-torque", "fuzzy"}
    for name in names:
        assert any(row.startswith(name) and row.endswith(": V' - claim") for row in rows)
        assert any(row.startswith(name) and row.endswith(": largest V' - bound") for row in rows)
    assert sum(row.startswith("wrong, ") for row in rows) == 5


def test_bounds_are_no_higher_than_they_must_be():
    """At some of the states all that could raise V' does."""
    measured = {check.what: check.measured for check in ledger(P, 1000).checks}
    for name in ("smc", "smc-integral", *ADAPTIVE):
        assert measured[f"{name}: largest V' - bound"] > -1e-6


def test_a_share_needs_states():
    with pytest.raises(ValueError, match=r"the number of states is 99; .* at least 100"):
        ledger(P, 99)


# ------------------------------------------------------------------- laws that are not right


def plus_sign(law: SlidingMode, state, measurement, reference):
    command, state = SlidingMode.__call__(law, state, measurement, reference)
    parts = command.signals
    return command._replace(force=parts["equivalent"] - parts["switching"]), state


def along_the_motion(law: SlidingMode, state, measurement, reference):
    """The equivalent force with C q' in place of C q_r'."""
    command, state = SlidingMode.__call__(law, state, measurement, reference)
    a_r = reference.a - law.lambda_ * (measurement.v - reference.v)
    force = law.nominal.inverse_dynamics(measurement.q, measurement.v, a_r)
    return command._replace(force=force + command.signals["switching"]), state


def without_linear_term(law, state, measurement, reference):
    command, after = type(law).__mro__[1].__call__(law, state, measurement, reference)
    return command._replace(force=command.force + law.K_v * command.signals["s"]), after


def wider_layer(law: BoundaryLayer, state, measurement, reference):
    law = BoundaryLayer(**vars(law) | {"phi": 1.5 * law.phi})
    return BoundaryLayer.__call__(law, state, measurement, reference)


def forgetful_integral(law: IntegralSlidingMode, state, measurement, reference):
    command, after = IntegralSlidingMode.__call__(law, state, measurement, reference)
    integral = after.integral - 0.1 * (measurement.q - reference.q) * (measurement.t - state.t)
    return command, after._replace(integral=integral)


def single_pole(law: IntegralSlidingMode, state, measurement, reference):
    """The middle term of (24) as lambda e."""
    command, after = IntegralSlidingMode.__call__(law, state, measurement, reference)
    e = measurement.q - reference.q
    return command._replace(force=command.force + law.K_v * e + 0.1 * e), after


def slack(law: FuzzySlidingMode, state, measurement, reference):
    """A fuzzy function that pushes back less than s / phi."""
    command, state = FuzzySlidingMode.__call__(law, state, measurement, reference)
    signals = dict(command.signals, switching=0.5 * command.signals["switching"])
    return command._replace(force=signals["equivalent"] + signals["switching"]), state


def weaker(law: FuzzySlidingMode, state, measurement, reference):
    """A switching gain that is not the one that was given."""
    law = FuzzySlidingMode(**vars(law) | {"K": 0.9 * law.K})
    return FuzzySlidingMode.__call__(law, state, measurement, reference)


def opposite_w(law: SuperTwisting, state, measurement, reference):
    return SuperTwisting.__call__(law, state._replace(w=-state.w), measurement, reference)


def with_rates(**factors: float) -> Callable:
    """Adaptation that goes wrong by a factor."""

    def law(law: AdaptiveFuzzy, state, measurement, reference):
        before = {name: getattr(state, name).copy() for name in factors}
        command, after = type(law).__mro__[1].__call__(law, state, measurement, reference)
        moved = {
            name: old + factors[name] * (getattr(after, name) - old) for name, old in before.items()
        }
        return command, after._replace(**moved)

    return law


def no_compensation(law: AdaptiveFuzzy, state, measurement, reference):
    command, after = AdaptiveFuzzy.__call__(law, state, measurement, reference)
    s = command.signals["s"]
    return command._replace(force=command.force + command.signals["E"] * np.sign(s)), after


BROKEN = [
    ("smc", SlidingMode, plus_sign),
    ("smc", SlidingMode, along_the_motion),
    ("smc-boundary", BoundaryLayer, wider_layer),
    ("smc-integral", IntegralSlidingMode, forgetful_integral),
    ("smc-integral", IntegralSlidingMode, single_pole),
    ("fsmc", FuzzySlidingMode, slack),
    ("fsmc", FuzzySlidingMode, weaker),
    *(
        (name, CONTROLLERS[name], without_linear_term)
        for name in ("smc", "smc-boundary", "smc-integral", "fsmc", "super-twisting")
    ),
    ("afsmc", AdaptiveFuzzy, without_linear_term),
    ("afsmc-consequent", AdaptiveConsequents, without_linear_term),
    ("super-twisting", SuperTwisting, opposite_w),
    ("afsmc-consequent", AdaptiveConsequents, with_rates(theta=-1.0)),
    ("afsmc-consequent", AdaptiveConsequents, with_rates(E=0.99)),
    ("afsmc", AdaptiveFuzzy, with_rates(theta=1.01)),
    ("afsmc", AdaptiveFuzzy, with_rates(alpha=0.0)),
    ("afsmc", AdaptiveFuzzy, with_rates(sigma=-1.0)),
    ("afsmc", AdaptiveFuzzy, no_compensation),
]


@pytest.mark.parametrize(("row", "kind", "call"), BROKEN, ids=lambda x: getattr(x, "__name__", x))
def test_a_broken_controller_fails_its_rows_and_no_others(monkeypatch, row, kind, call):
    broken = dataclasses.dataclass(frozen=True, kw_only=True, eq=False)(
        type("Broken", (kind,), {"__call__": call})
    )
    name = row.split(",")[0]
    monkeypatch.setitem(CONTROLLERS, name, broken)
    failed = [check.what for check in ledger(P, 200).checks if not check.passed]
    assert failed and all(what.startswith(row) for what in failed)


@pytest.mark.parametrize(
    ("misprint", "least"),
    [
        (adaptive_ledger.printed_C, 0.05),
        (adaptive_ledger.delta_gradient, 0.05),
        (adaptive_ledger.added_estimate, 0.2),
        (adaptive_ledger.paper_coriolis, 0.002),
    ],
    ids=lambda x: getattr(x, "__name__", ""),
)
def test_a_misprint_lets_V_rise_where_the_right_law_does_not(misprint, least):
    rng = np.random.default_rng(0)
    t = adaptive_ledger.adaptive_trial("afsmc", BARE, 3000, rng)
    rounding = 1e-12 * lyapunov.rms(t.claim)
    assert np.max(t.rate) < rounding and np.max(t.claim) <= rounding
    assert np.mean(misprint(t).rate > rounding) > least


# ------------------------------------------------------------------- the parts, one by one


def test_the_drawn_states_cover_the_layer_and_the_rules():
    at = draw(3000)
    layer = np.repeat([0.05, 0.8], 3)
    for surface in (lyapunov.sliding(at), lyapunov.integral_sliding(at)):
        np.testing.assert_allclose(surface.s + surface.v_r, at.measurement.v)
        z = surface.s / layer
        assert 0.1 < np.mean(np.all(np.abs(z) < 1.0, axis=-1)) < 0.6
        assert np.all(np.max(np.abs(z), axis=0) > 2.0)


def test_the_surfaces_move_as_their_derivatives_say():
    """s of states a moment apart, along any acceleration: s' = q'' - q_r''."""
    at, h = draw(50), 1e-6
    acceleration = np.full_like(at.measurement.q, 30.0)

    def later(t: float):
        (_, q, v), (q_d, v_d, a_d) = at.measurement, at.reference
        q, v = q + t * v + 0.5 * t * t * acceleration, v + t * acceleration
        q_d, v_d = q_d + t * v_d + 0.5 * t * t * a_d, v_d + t * a_d
        integral = at.integral + t * (at.measurement.q - at.reference.q)
        return at._replace(
            measurement=at.measurement._replace(q=q, v=v),
            reference=at.reference._replace(q=q_d, v=v_d),
            integral=integral,
        )

    for surface in (lyapunov.sliding, lyapunov.integral_sliding):
        rate = (surface(later(h)).s - surface(later(-h)).s) / (2.0 * h)
        np.testing.assert_allclose(acceleration - surface(at).a_r, rate, rtol=1e-6, atol=1e-5)


def test_energy_rate_is_the_rate_of_the_kinetic_energy_when_nothing_is_wanted():
    """With q_r' = 0, V is the kinetic energy and V' the power of all forces."""
    at = draw(arm=P)
    force = np.full_like(at.measurement.q, 0.7)
    _, q, v = at.measurement
    still = Surface(v, np.zeros_like(v), np.zeros_like(v))
    power = np.sum(v * (force - lagrange.potential_force(P, q)), axis=-1)
    power = power - np.einsum("ni,ij,nj->n", v, lagrange.damping_matrix(P), v)
    rate = lyapunov.energy_rate(at, still, force)
    np.testing.assert_allclose(rate, power, rtol=1e-9, atol=1e-9 * np.max(np.abs(power)))


def test_the_model_error_is_the_difference_of_two_recursions():
    at = draw()
    surface = lyapunov.sliding(at)
    _, q, v = at.measurement
    both = (
        lagrange.inverse_dynamics(p, q, v, surface.a_r, surface.v_r) for p in (at.nominal, at.true)
    )
    expected = next(both) - next(both)
    np.testing.assert_allclose(lyapunov.model_error(at, surface), expected, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("normalised", [False, True])
def test_the_error_of_the_approximation_is_what_eq_73_leaves(normalised: bool):
    t = adaptive_ledger.adaptive_trial(
        "afsmc", P, 200, np.random.default_rng(2), normalised=normalised
    )
    s, now, tilde = t.surface.s, t.now, adaptive_ledger.difference(t.best, t.now)
    z = (s / t.law.scale)[..., None]
    mu = np.exp(-((now.sigma * (z - now.alpha)) ** 2))
    d_alpha = 2.0 * now.sigma**2 * (z - now.alpha) * mu
    d_sigma = -2.0 * now.sigma * (z - now.alpha) ** 2 * mu
    change = d_alpha * tilde.alpha + d_sigma * tilde.sigma
    phi = mu
    if normalised:
        total = np.sum(mu, axis=-1, keepdims=True)
        change = (change - mu / total * np.sum(change, axis=-1, keepdims=True)) / total
        phi = mu / total
    missed = lyapunov.model_error(t.at, t.surface) - np.sum(now.theta * phi, axis=-1)
    linear = np.sum(now.theta * change + tilde.theta * phi, axis=-1)
    np.testing.assert_allclose(linear + t.eps, missed, rtol=1e-9, atol=1e-9)


def test_a_smaller_step_gives_the_same_rates():
    t = adaptive_ledger.adaptive_trial("afsmc", P, 50, np.random.default_rng(2))
    (force, whole), (again, small) = (
        adaptive_ledger.answer(t.law, t.at, t.now, step) for step in (1.0, 1e-3)
    )
    np.testing.assert_array_equal(force, again)
    for one, other in zip(whole, small, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, atol=1e-9)
        assert np.any(one != 0.0)


def test_the_layout_of_the_paper_is_that_of_its_eq_4():
    """On the columns of the slides, entry by entry; and C q' is the same."""
    at = draw(5)
    _, q, v = at.measurement
    C = adaptive_ledger.layout_of_the_paper(BARE, q, v)
    np.testing.assert_allclose(
        np.einsum("nij,nj->ni", C, v),
        np.einsum("nij,nj->ni", lagrange.coriolis_matrix(P, q, v), v),
        atol=1e-12,
    )
    printed = sp.lambdify(
        [*errata.q, *errata.v, *errata.m],
        errata.rate_matrix_in_paper_layout()[:, :3].subs(
            dict.fromkeys((*errata.c1, *errata.c2), 0)
        ),
    )
    for k in range(5):
        expected = np.array(printed(*q[k], *v[k], *P.mass))
        np.testing.assert_allclose(C[k, :, :3], expected, atol=1e-12)


# ------------------------------------------------------------------------- the command line


def test_the_command_prints_the_ledger(capsys, tmp_path):
    file = tmp_path / "report.json"
    arguments = ["validate", "--controllers", "--states", "200", "--json", str(file)]
    assert cli.main(arguments) == 0
    out, err = capsys.readouterr()
    assert "Controllers against their Lyapunov functions: 3 modules, 200 states, seed 0" in out
    assert "MuJoCo" not in out and err == ""
    (report,) = json.loads(file.read_text())
    assert report["passed"] and report["states"] == 200
    assert f"all {len(report['checks'])} checks passed" in out


def test_the_command_takes_other_arms_and_says_what_failed(capsys, monkeypatch):
    options = ["--controllers", "--states", "100", "--modules", "2", "--random-parameters", "2"]
    assert cli.main(["validate", *options]) == 0
    assert capsys.readouterr().out.count("2 modules, 100 states") == 2

    class Broken(SlidingMode):
        __call__ = plus_sign

    monkeypatch.setitem(CONTROLLERS, "smc", Broken)
    assert cli.main(["validate", *options[:3]]) == 1
    assert "FAIL" in capsys.readouterr().out
    assert cli.main(["validate", "--controllers", "--states", "20"]) == 2
    assert (
        "the number of states is 20; the controllers need at least 100" in capsys.readouterr().err
    )

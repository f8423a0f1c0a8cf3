"""`octarm validate --rod`: what it says of chains that converge, and of some that do not."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from octarm.arm.rod import Rod, arm_from_rod
from octarm.checks import rod_convergence, rod_study
from octarm.checks.rod_convergence import MODULES, Curve, Study, table
from octarm.commands import cli
from octarm.commands import validate as command

ROD = Rod()


@pytest.fixture(scope="module")
def study():
    """The whole comparison, but for PyElastica."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rod_study, "installed", lambda: False)
        return rod_convergence.study()


def percent(study: Study, case: str, layout: str) -> np.ndarray:
    (errors,) = (c.errors for c in study.curves if (c.case, c.layout) == (case, layout))
    return 100.0 * errors


@pytest.mark.slow
def test_all_rows_pass(study):
    assert [check for check in study.table.checks if not check.passed] == []


_ = np.nan


@pytest.mark.parametrize(
    ("case", "layout", "expected", "within"),
    [  # errors [%] of N = 1, 2, 3, 5, 10, 20, 40, by an independent computation, rounded
        ("tip at 1 rad", "paper", [-100, -52, -34, -20, -9.5, -4.7, -2.3], 0.51),
        ("tip at 1 rad", "paper", [_, _, _, _, -9.5, -4.7, -2.3], 0.051),
        ("tip at 1 rad", "centred", [-37, -10, -4.7, -1.9, -0.61, -0.22, -0.09], 0.51),
        ("tip at 1 rad", "centred", [_, _, -4.7, -1.9, -0.61, -0.22, -0.09], 0.051),
        ("tip at 1 rad", "centred", [_, _, _, _, -0.61, -0.22, -0.09], 0.0051),
        ("small tip load", "half-half", [-25, -6.3, -2.8, -1.0, -0.25, -0.06, -0.02], 0.051),
        ("tip at 1 rad", "half-half", [-35, -9.3, -4.1, -1.4, -0.36, -0.09, -0.02], 0.41),
        ("tip at 1 rad", "half-half", [_, -9.3, -4.1, -1.4, -0.36, -0.09, -0.02], 0.051),
        ("weight across", "half-half", [-12, -2.9, -1.2, -0.42, -0.1, -0.03, -0.01], 0.061),
        ("weight along", "half-half", [0, 0, 0, 0, 0, 0, 0], 1e-9),
        ("bending frequency 1", "paper", [163, 11.5, 4.8, 1.5, 0.27, 0.01, _], 0.51),
        ("bending frequency 1", "paper", [_, 11.5, 4.8, 1.5, 0.27, 0.01, _], 0.051),
        ("bending frequency 1", "paper", [_, _, _, _, 0.27, 0.01, _], 0.0051),
        ("bending frequency 1", "centred", [272, 13, 5.6, 2.0, 0.5, 0.12, _], 0.51),
        ("bending frequency 1", "centred", [_, _, 5.6, 2.0, 0.5, 0.12, _], 0.051),
        ("axial frequency 1", "paper", [-36, -21, -15, -9.4, -4.9, -2.5, _], 0.51),
        ("axial frequency 1", "paper", [_, _, _, -9.4, -4.9, -2.5, _], 0.051),
        ("release, tip in 1 s", "paper", [_, 38, 21, 10.5, 4.8, 2.3, _], 0.51),
        ("release, tip in 1 s", "paper", [_, _, _, 10.5, 4.8, 2.3, _], 0.051),
        # Compared there with a chain of finitely many modules, which is itself .1 % off.
        ("release, tip in 1 s", "centred", [_, 36, 18, 6.3, 1.6, 0.32, _], 0.51),
        ("release, tip in 1 s", "centred", [_, _, _, 6.3, 1.6, 0.32, _], 0.15),
    ],
)
@pytest.mark.slow
def test_errors_are_those_of_an_independent_computation(study, case, layout, expected, within):
    errors = percent(study, case, layout)
    known = ~np.isnan(expected)
    np.testing.assert_allclose(errors[known], np.array(expected)[known], rtol=0.0, atol=within)


@pytest.mark.parametrize(
    ("case", "paper", "centred"),
    [
        ("small tip load", (30, 150), (3, 5)),
        ("bending frequency 1", (3, 10), (5, 10)),
        ("release, tip in .3 s", (10, 45), (5, 10)),
    ],
)
@pytest.mark.slow
def test_how_many_modules_are_enough(study, case, paper, centred):
    for layout, enough in (("paper", paper), ("centred", centred)):
        (curve,) = (c for c in study.curves if (c.case, c.layout) == (case, layout))
        needed = [curve.needed(error) for error in (0.05, 0.01)]
        for found, listed in zip(needed, enough, strict=True):
            assert 0.5 * listed <= found <= listed


def test_errors_of_powers_have_their_order_and_limit_and_number_of_modules():
    n = np.array(MODULES, dtype=float)
    first = Curve("a", "paper", 0.3 / n - 0.1 / n**2 + 0.02, 1)
    second = Curve("b", "centred", -0.25 / n**2, 2)
    assert second.observed == pytest.approx(2.0, rel=1e-12)
    assert [second.needed(x) for x in (0.3, 0.05, 0.01, 1e-5)] == [1, 3, 5, 159]
    failed = [check.what for check in first.checks() if not check.passed]
    assert failed == ["a, paper: order"]
    assert [check.passed for check in second.checks()] == [True]
    none = Curve("c", "paper", np.full(7, 1e-12), 0)
    assert [check.passed for check in none.checks()] == [True]
    assert table([first, second]).splitlines()[2].split()[:3] == ["b", "centred", "-25.0"]


@pytest.mark.parametrize(
    ("field", "rows"),
    [
        ("", set()),
        ("EI", {"small tip load, centred: order",
                "small tip load, paper: closed form",
                "bending frequency 1, centred: order"}),
        pytest.param("EA", {"weight along, centred: largest error",
                            "axial frequency 1, paper: order"},
                     marks=pytest.mark.slow),
        pytest.param("density", {"weight across, centred: order",
                                 "axial frequency 1, centred: order"}, marks=pytest.mark.slow),
    ],
)  # fmt: skip
def test_the_rod_passes_and_one_that_is_another_by_a_percent_fails(monkeypatch, field, rows):
    """Under small loads, and without letting it go."""

    def stiffer(rod: Rod, modules: int, layout: str = "paper"):
        if field:
            rod = dataclasses.replace(rod, **{field: 1.01 * getattr(rod, field)})
        return arm_from_rod(rod, modules, layout)

    monkeypatch.setattr(rod_convergence, "arm_from_rod", stiffer)
    monkeypatch.setattr(rod_study, "installed", lambda: False)
    for name in ("_motion", "_large_load", "_tapered"):
        monkeypatch.setattr(rod_convergence, name, lambda *_: iter(()))
    failed = {c.what for c in rod_convergence.study().table.checks if not c.passed}
    assert rows <= failed and bool(rows) == bool(failed)


def test_both_engines_let_a_chain_go_alike(monkeypatch):
    p = arm_from_rod(ROD, 4, "centred")
    tips = []
    for engine in ("mujoco", "lagrange"):
        monkeypatch.setattr(rod_study, "usual_engine", lambda name=engine: name)
        tips.append(rod_study.released(p))
    assert rod_study.distance(ROD, *tips) < 1e-9
    np.testing.assert_allclose(tips[0][0], [ROD.length, 0.0], atol=1e-15)


@pytest.mark.slow
def test_pyelastica_s_rod_moves_like_the_chain_of_its_own_discretisation():
    pytest.importorskip("elastica")
    motions: dict[str, np.ndarray] = {}
    checks = list(rod_convergence._peer(motions))
    assert [c for c in checks if not c.passed] == []
    assert len(checks) == 4
    rod = rod_study.slim_rod()
    coarse = rod_study.distance(rod, motions["PyElastica, n = 20"], motions["rod"])
    assert coarse > 0.1  # far from the rod, and all the same near the chain


@pytest.mark.slow
def test_the_command_prints_the_table_and_draws_figures(study, monkeypatch, tmp_path, capsys):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(command, "study", lambda _: study)
    assert cli.main(["validate", "--rod", "--out", "figures", "--json", "rod.json"]) == 0
    out = capsys.readouterr().out
    assert "weight across, tapered" in out
    assert "PyElastica is not installed" in out
    names = {path.name for path in Path("figures").iterdir()}
    assert names == {f"{x}.{kind}" for x in ("convergence", "release") for kind in ("png", "svg")}
    (report,) = json.loads(Path("rod.json").read_text())
    assert report["passed"]
    assert report["modules"] == list(MODULES)
    assert report["curves"][0]["error"][0] == pytest.approx(-1.0)


@pytest.mark.slow
def test_a_failed_row_is_exit_code_1(study, monkeypatch, capsys):
    failed = study._replace(table=study.table.__class__("t", {}, 0, 0, (_failing(),)))
    monkeypatch.setattr(command, "study", lambda _: failed)
    assert cli.main(["validate", "--rod"]) == 1
    assert "1 of 1 checks FAILED" in capsys.readouterr().out


def _failing():
    (check, *_) = Curve("a", "paper", np.full(7, 0.5), 1).checks()
    return check


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--rod", "--engines"], "--engines and --rod are given; one check at a time"),
        (["--out", "x"], "--out is given without --rod, which alone draws figures"),
    ],
)
def test_options_that_do_not_go_together_are_refused(words, sentence, capsys):
    assert cli.main(["validate", *words]) == 2
    assert sentence in capsys.readouterr().err

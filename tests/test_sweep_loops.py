"""The sampled loops of a sweep in its report, beside what its episodes did."""

import dataclasses
from pathlib import Path

import pytest

import octarm
from controllers import make_controller
from octarm.arm.groups import groups_of
from octarm.checks.stability import LoopAtRest, linear_plant, loop_at_rest
from octarm.commands import report
from octarm.commands.cli import main
from octarm.commands.report import LoopRow, loops_of
from octarm.reports.frame import read_episodes

LAW = """
import dataclasses
from octarm.interfaces import Command

@dataclasses.dataclass(frozen=True, eq=False)
class Damper:
    nominal: object
    K_v: float = 0.3

    def initial_state(self, batch_shape=()):
        return ()

    def __call__(self, state, measurement, reference):
        model = self.nominal.inverse_dynamics(reference.q, reference.v, reference.a)
        return Command(model - self.K_v * (measurement.v - reference.v)), state
"""
SPEC = """
duration = 0.3
settle = 0.1
engine = "lagrange"
timestep = "auto"
control_period = 0.0005
[grid]
controller = ["pd", "smc", "smc-boundary", "./damper.py:Damper"]
plant_modules = [15, 3]
"""


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("loops")
    (folder / "damper.py").write_text(LAW, encoding="utf-8")
    (folder / "spec.toml").write_text(SPEC, encoding="utf-8")
    out = str(folder / "s")
    assert main(["sweep", str(folder / "spec.toml"), "--out", out, "--workers", "1"]) == 0
    return folder


def rows(folder: Path, *, run_code: bool = False) -> dict[tuple[str, str], LoopRow]:
    found = loops_of(folder / "s", read_episodes(folder / "s"), run_code)
    return {(row.controller, row.where["plant_modules"]): row for row in found.rows}


def test_rows_are_what_octarm_arm_says_beside_what_simulation_did(made: Path):
    p, found = octarm.nominal_parameters(), rows(made)
    assert len(found) == 8
    for modules in (3, 15):
        finer = groups_of(p, modules) if modules > 3 else None
        loop = loop_at_rest(linear_plant(p, finer), make_controller("smc-boundary", p), 5e-4)
        row = found["smc-boundary", str(modules)]
        assert row.loop.longest == loop.longest and row.loop.radius == loop.radius
        assert row.loop.mode == loop.mode
        assert row.predicted == ("stable" if modules == 3 else "unstable")
        assert (row.episodes, row.poor) == (1, 0 if modules == 3 else 1)
        assert row.agrees
    smc = found["smc", "3"]
    assert "sgn(s)" in smc.loop.reason and smc.predicted == "" and smc.agrees


def test_code_of_ones_own_is_run_if_it_is_asked_for_alone(made: Path):
    file, text = made / "damper.py", (made / "damper.py").read_text(encoding="utf-8")
    p = octarm.nominal_parameters()
    loop = loop_at_rest(linear_plant(p), make_controller(f"{file}:Damper", p), 5e-4)
    assert rows(made, run_code=True)["Damper", "3"].loop.longest == loop.longest
    assert "--run-code" in rows(made)["Damper", "3"].loop.reason
    file.write_text("raise SystemError('it was imported')", encoding="utf-8")
    try:
        assert main(["report", str(made / "s"), "--out", str(made / "r")]) == 0
        changed = rows(made, run_code=True)["Damper", "3"]
        assert "was changed since" in changed.loop.reason
    finally:
        file.write_text(text, encoding="utf-8")


def test_the_page_and_the_terminal_have_them(made: Path, capsys):
    assert main(["report", str(made / "s"), "--out", str(made / "p"), "--run-code"]) == 0
    said = capsys.readouterr()
    assert "Prediction and simulation agree in " in said.out
    assert "damper.py:Damper, the same file as then" in said.err
    page = (made / "p" / "report.html").read_text(encoding="utf-8")
    assert "the sampled loops about rest" in page and "switches by sgn(s)" in page
    assert "--run-code" in page.partition("How to reproduce it")[2]


def test_rows_beyond_a_pages_are_left_out_openly(made: Path, monkeypatch):
    monkeypatch.setattr(report, "_MOST", 3)
    found = loops_of(made / "s", read_episodes(made / "s"), False)
    assert len(found.rows) == 3 and "of the first 3 of all 8" in found.caption


def test_other_gains_than_those_of_the_sweep_are_not_taken_for_them(made: Path):
    episodes = read_episodes(made / "s")
    gains = episodes.manifest["gains"]
    changed = {**gains, "pd": {**gains["pd"], "K_v": 1.0}}
    episodes = dataclasses.replace(episodes, manifest={**episodes.manifest, "gains": changed})
    reasons = {
        row.controller: row.loop.reason for row in loops_of(made / "s", episodes, False).rows
    }
    assert "not those that the sweep had" in reasons["pd"]
    assert reasons["smc-boundary"] == ""


@pytest.mark.parametrize(
    ("longest", "poor", "disturbed", "judged", "agrees"),
    [
        (1e-3, 0, False, True, True),
        (1e-3, 3, False, True, False),
        (1e-3, 3, True, False, True),  # the disturbance may have done it
        (1e-3, 0, True, True, True),
        (1e-4, 0, True, True, False),
        (1e-4, 3, True, True, True),
    ],
)
def test_disturbances_excuse_only_what_they_can_do(
    longest: float, poor: int, disturbed: bool, judged: bool, agrees: bool
):
    loop = LoopAtRest(period=5e-4, radius=0.9 if longest > 5e-4 else 1.1, longest=longest)
    row = LoopRow("pd", {}, loop, episodes=8, diverged=0, poor=poor, disturbed=disturbed)
    assert (row.judged, row.agrees) == (judged, agrees)

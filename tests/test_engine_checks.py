"""That the engines agree: what a sweep and `octarm validate --engines` say about it."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from controllers import make_controller
from octarm.arm.mjcf import nominal_parameters
from octarm.checks import closed_loops as engines
from octarm.commands.cli import main
from octarm.interfaces import Command, Instant, Measurement, Reference
from octarm.simulation import analytic
from octarm.sweeps import engine_check
from octarm.sweeps.engine_check import TipPaths, checked_episodes
from octarm.sweeps.plan import Plan, with_step
from octarm.sweeps.shards import begin, run_arms
from octarm.sweeps.spec_file import parse_spec
from octarm.sweeps.store import open_sweep, read_sweep

P = nominal_parameters()
SPEC = """
engine = "lagrange"
episodes = 60
duration = 0.02
batch = 50
seed = 3
[grid]
controller = ["smc-boundary", "pd"]
[grid.disturbance]
noise = [0.0, 0.4]
"""

CHANGED = SPEC + "tilt = [0.0, 0.2]\npayload = [0.0, 0.1]\n[disturbance]\nloss = 0.2\n"
LOST = SPEC.replace("60", "20") + "step.amplitude = [0, 9000]\n[disturbance]\nstep.at = 0.005\n"
FINER = SPEC.replace("[grid]", "plant_modules = 9\ncontrol_period = 0.001\n[grid]")


def test_every_law_is_compared_under_every_disturbance():
    names: list[str] = []
    table = engines.compare_engines(
        P, make_controller, ["pd", "smc"], ["smc"], duration=0.03, progress=names.append
    )
    assert table.passed and names == ["pd", "smc"]
    assert [check.what.partition(",")[0] for check in table.checks] == names
    assert all(check.measured < 1e-12 and check.high == 1e-9 for check in table.checks)


@pytest.mark.parametrize("law", ["pd", "super-twisting"])
def test_engines_are_compared_on_all_modules_of_a_finer_plant(
    law: str, monkeypatch: pytest.MonkeyPatch
):
    """They agree on it, and a module inside a group that is off by 1e-5 shows."""
    options = {"duration": 0.02, "plant_modules": 9, "layout": "centred"}
    table = engines.compare_engines(P, make_controller, [law], ["super-twisting"], **options)
    assert table.passed and "on a plant of 9 modules (centred)" in table.title
    assert table.checks[0].measured < 1e-12
    real = analytic.PlantRows.write

    def wrong(self, p, gravity_angle=0.0):
        softer = np.where(np.arange(9) == 4, 1.0 - 1e-5, 1.0)
        return real(self, p.scaled(stiffness=softer), gravity_angle)

    monkeypatch.setattr(analytic.PlantRows, "write", wrong)
    again = engines.compare_engines(P, make_controller, [law], ["super-twisting"], **options)
    assert not again.passed


def test_the_command_rolls_forces_off_on_a_finer_plant(monkeypatch: pytest.MonkeyPatch, capsys):
    from octarm.commands import validate

    asked: list[dict] = []
    real = validate.compare_engines

    def short(arm, make, laws, switching, **options: Any):
        asked.append(options | {"law": make("pd", arm)})
        options["duration"] = 0.005
        return real(arm, make, ["pd"], switching, **options)

    monkeypatch.setattr(validate, "compare_engines", short)
    assert main(["validate", "--engines", "--plant-modules", "9", "--layout", "centred"]) == 0
    assert "on a plant of 9 modules (centred)" in capsys.readouterr().out
    assert asked[0]["plant_modules"] == 9 and asked[0]["layout"] == "centred"
    assert asked[0]["law"].roll_off == pytest.approx(62.6, rel=1e-3)
    assert main(["validate", "--plant-modules", "9"]) == 2
    assert "is given without --engines" in capsys.readouterr().err
    assert main(["validate", "--engines", "--plant-modules", "10"]) == 2
    assert "must be a multiple of the arm's 3" in capsys.readouterr().err


def test_each_arm_has_one_disturbance_of_its_own():
    for i, disturbance in enumerate(engines.one_each()):
        values = next(x for x in vars(disturbance).values() if isinstance(x, np.ndarray)).ravel()
        (odd,) = np.flatnonzero(values != values[0])
        assert odd == i + 1


@pytest.mark.parametrize("law", ["pd", "smc"])
def test_an_engine_that_is_wrong_fails(law: str, monkeypatch: pytest.MonkeyPatch):
    """A spring that is off by 1e-6."""
    real = analytic.PlantRows.write

    def wrong(self, p, gravity_angle=0.0):
        return real(self, p.scaled(stiffness=1.0 + 1e-6), gravity_angle)

    monkeypatch.setattr(analytic.PlantRows, "write", wrong)
    table = engines.compare_engines(P, make_controller, [law], ["smc"], duration=0.03)
    assert not table.passed


@pytest.mark.parametrize(("parted", "passed"), [(60, True), (80, False)])
def test_an_arm_is_compared_until_its_loop_magnifies_rounding(parted: int, passed: bool):
    """The engines are 1 mm apart from instant 70 on; so is the nudged run from `parted` on."""
    t, q = np.linspace(0.0, 1.0, 100), np.zeros((100, 20, 6))
    apart = [np.where(np.arange(100) >= k, 1e-3, 0.0)[:, None, None] + q for k in (70, parted)]
    one, two, nudged = ((t, x, q, q + 1.0) for x in (q, *(q + x for x in apart)))
    nudged = nudged[0], two[1] + apart[1], *nudged[2:]
    check = engines._check("law", one, two, nudged, np.ones(6), switches=False)
    assert check.passed == passed
    assert ("20 arms until rounding decides" in check.what) == (parted < 100)


def test_an_hundredth_of_the_episodes_is_drawn_by_the_seed():
    plan = Plan(parse_spec(SPEC))
    episodes = checked_episodes(plan)
    assert len(episodes) == len(set(episodes.tolist())) == 3
    np.testing.assert_array_equal(episodes, checked_episodes(plan))
    other = Plan(parse_spec(SPEC.replace("seed = 3", "seed = 4")))
    assert set(checked_episodes(other).tolist()) != set(episodes.tolist())
    few = Plan(parse_spec('engine = "lagrange"\ncontroller = "pd"\nduration = 0.01'))
    assert checked_episodes(few).tolist() == [0]
    assert not checked_episodes(Plan(parse_spec(SPEC.replace("lagrange", "mujoco")))).size


def test_paths_are_compared_until_an_arm_diverges():
    one, two = (paths([0.0, 0.1, 0.2], shift) for shift in (0.0, [0.0, 1e-6, 5.0]))
    never = np.full(2, np.nan)
    np.testing.assert_allclose(one.difference(two, never, never), 5.0)
    lost = np.array([np.nan, 1.0])
    np.testing.assert_allclose(one.difference(two, lost, lost), [5.0, 1e-6])
    assert one.difference(two, lost, never)[1] == np.inf


def paths(s: list[float], shift) -> TipPaths:
    out = TipPaths(np.array([0, 2]), periods=3)
    for k, (x, dx) in enumerate(zip(s, np.broadcast_to(shift, 3), strict=True)):
        q = np.zeros((3, 6))
        q[:, 0] = x + dx
        zero = np.zeros_like(q)
        measurement, reference = Measurement(0.5 * k, q, zero), Reference(zero, zero, zero)
        out(Instant(measurement, reference, Command(zero, {}), q, zero, zero, zero))
    return out


def test_a_sweep_states_how_far_the_engines_are_apart(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    spec, swept = tmp_path / "spec.toml", tmp_path / "out"
    spec.write_text(SPEC, encoding="utf-8")
    assert main(["sweep", str(spec), "--out", str(swept), "--workers", "1"]) == 0
    said = capsys.readouterr().out
    assert "3 of 240 episodes ran on MuJoCo as well as on lagrange: tips are at most" in said
    table = read_sweep(swept)
    column = table["engine_difference"].to_numpy()
    checked = np.flatnonzero(~np.isnan(column))
    np.testing.assert_array_equal(checked, checked_episodes(Plan(parse_spec(SPEC))))
    assert np.nanmax(column) < 1e-12
    manifest = open_sweep(swept)[1]
    assert manifest["spec"]["engine"] == "lagrange"
    assert "numba" in manifest["starts"][0]["versions"]
    assert main(["verify", str(swept), "--episode", str(checked[0]), "--episode", "0"]) == 0
    monkeypatch.setattr(engine_check, "LIMIT", -1.0)
    assert main(["sweep", str(spec), "--out", str(swept), "--workers", "1", "--resume"]) == 1
    assert "beyond the limit" in capsys.readouterr().out


@pytest.mark.parametrize("text", [CHANGED, LOST, FINER])
def test_arms_of_a_batch_that_mujoco_steps_are_those_of_mujoco(text: str):
    """Also under changes of the plant, when arms are lost, and on finer plants."""
    plan = Plan(with_step(parse_spec(text)))
    mujoco = Plan(dataclasses.replace(plan.spec, engine="mujoco"))
    shard = np.array(plan.shard(0))
    again = shard[[0, 1, -1]]
    physics = begin(mujoco.spec, mujoco.arms(again), make_controller)[0].physics
    both = plan.arms(np.concatenate([shard, again]))
    rows = run_arms(plan, both, make_controller, twins=physics)
    alone = run_arms(plan, plan.arms(shard), make_controller)
    there = run_arms(mujoco, mujoco.arms(again), make_controller)
    same = set(rows.column_names) - {"wall_time", "engine_difference"}
    for name in same:
        assert rows[name].to_pylist()[: len(shard)] == alone[name].to_pylist(), name
    assert rows["diverged_at"].to_pylist()[-3:] == there["diverged_at"].to_pylist()
    assert (text == LOST) == (there["diverged_at"].null_count < 3)
    for name in ("status", "peak_error_theta1", "energy_theta2", "digest"):
        assert rows[name].to_pylist()[-3:] == there[name].to_pylist(), name


def test_the_option_takes_the_place_of_the_specs_engine(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    spec, out = tmp_path / "spec.toml", tmp_path / "out"
    spec.write_text(SPEC.replace("60", "2"), encoding="utf-8")
    assert main(["sweep", str(spec), "--out", str(out), "--engine", "mujoco"]) == 0
    assert open_sweep(out)[1]["spec"]["engine"] == "mujoco"
    assert "engine_difference" not in read_sweep(out).column_names
    assert "lagrange" not in capsys.readouterr().out
    assert main(["sweep", str(spec), "--out", str(out), "--engine", "abacus"]) == 2
    assert "unknown engine 'abacus'" in capsys.readouterr().err


def test_a_run_on_it_is_verified_on_it(tmp_path: Path):
    out = str(tmp_path / "run")
    options = ["--duration", "0.05", "--disturbance", "noise:0.4", "--out", out]
    assert main(["run", "--engine", "lagrange", *options]) == 0
    description = (tmp_path / "run" / "run.json").read_text(encoding="utf-8")
    assert '"engine": "lagrange"' in description and '"numba"' in description
    assert main(["verify", out]) == 0
    assert main(["plot", out, "--out", str(tmp_path / "figures")]) == 0

"""The arm, its model and gains, given alike to octarm run, margin and tune; what columns mean."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest
from small_tuning import BUDGET

import octarm
from octarm.arm.mjcf import nominal_parameters
from octarm.commands.cli import main
from octarm.commands.options import ArmOptions, GainOptions, spelt
from octarm.disturbances.plant import Payload
from octarm.metrics.table import METRICS
from octarm.sweeps.scenarios import Examination, Scenario
from octarm.sweeps.shards import schema
from octarm.sweeps.spec_file import parse_spec
from octarm.sweeps.tune import Budget
from octarm.sweeps.tune_cost import Rig, costs

P = nominal_parameters()
OPTIONS = ["--parameter=mass:0.4,0.3,0.2", "--nominal=stiffness:0.8", "--mismatch=-10%"]


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)


def test_options_give_an_arm_and_what_is_believed_of_it():
    true, believed = ArmOptions(
        parameter=("mass:0.4,0.3,0.2",), nominal=("stiffness:0.8",), mismatch=-0.1
    ).both()
    np.testing.assert_array_equal(true.mass, [0.4, 0.3, 0.2])
    np.testing.assert_allclose(believed.mass, 0.9 * true.mass)
    np.testing.assert_allclose(believed.stiffness, 0.8 * 0.95 * P.stiffness)
    assert spelt(ArmOptions()) == spelt(GainOptions()) == []
    options = ArmOptions(arm="eth", nominal=("mass:0.7", "width:1.1"), plant_modules=9)
    words = ["--arm=eth", "--nominal=mass:0.7", "--nominal=width:1.1", "--plant-modules=9"]
    assert spelt(options) == words
    assert spelt(GainOptions(gain=("K:2",))) == ["--gain=K:2"]


def test_a_margin_is_that_of_the_runs_that_octarm_run_makes(capsys: pytest.CaptureFixture[str]):
    """The margin of a bound that is the metric of one run, up to the resolution of the search."""
    own = [*OPTIONS, "--gains", "recommended", "--gain", "lambda:12", "--settle", "50ms"]
    same = [*own, "--duration", "0.2", "--reference", "multi-sine"]
    words = ["--controller", "smc-boundary", "--disturbance", "payload:0.1", *same]
    assert main(["run", *words, "--out", "a"]) == 0
    bound = json.loads(Path("a/run.json").read_text())["metrics"]["tip_rms_error"]
    words = ["margin", "smc-boundary", "--disturbance", "payload", "--high", "0.3", *same]
    words += ["--bound", f"tip_rms_error:{bound!r}", "--seeds", "1", "--engine", "mujoco"]
    assert main([*words, "--json", "m.json"]) == 0
    report = json.loads(Path("m.json").read_text())
    assert report["controllers"][0]["margin"] == pytest.approx(0.1, rel=0.02)
    assert report["settings"]["parameter"] == ["mass:0.4,0.3,0.2"]
    assert report["settings"]["gain"] == ["lambda:12"] and report["settings"]["settle"] == 0.05
    assert "multi-sine" in capsys.readouterr().out


def test_a_rig_has_what_all_scenarios_shall_have():
    """The cost of a scenario is that of another one with what the rig has in addition."""
    from controllers import make_controller

    def factory(nominal, gains):
        return make_controller("smc-boundary", nominal, gains, gain_set="recommended")

    def cost(scenario: Scenario, rig: Rig) -> float:
        trial = Examination(scenarios=(scenario,), begin=0.02, duration=0.1)
        return costs([trial], factory, {"lambda": np.full((1, 1), 12.0)}, rig=rig)[0].item()

    plain, more = Rig("mujoco"), Rig("mujoco", reference="sine", mismatch=-0.2)
    assert cost(Scenario(reference="fast-sine"), more) == pytest.approx(
        cost(Scenario(reference="sine", mismatch=-0.2), plain), rel=1e-12
    )
    loaded = Rig("mujoco", disturbances=(Payload(mass=0.1),))
    assert cost(Scenario(reference="sine"), loaded) == pytest.approx(
        cost(Scenario(reference="sine", payload=0.1), plain), rel=1e-12
    )
    assert plain.settings() == {"engine": "mujoco"}
    assert more.settings() == {"engine": "mujoco", "reference": "sine", "mismatch": -0.2}
    assert loaded.settings()["disturbances"][0]["mass"] == 0.1


def test_tune_takes_what_run_takes_and_writes_it_down(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(Budget, "within", classmethod(lambda cls, seconds: BUDGET))
    words = ["tune", "pd", "--out", "g.toml", "--workers", "1", *OPTIONS]
    words += ["--reference", "sine", "--disturbance", "payload:50g", "--gain", "K_d:3"]
    assert main(words) == 0
    tuning = tomllib.loads(Path("g.toml").read_text())["tuning"]
    assert tuning["reference"] == "sine" and tuning["mismatch"] == -0.1
    assert tuning["disturbances"][0]["mass"] == 0.05
    assert "--nominal=stiffness:0.8" in tuning["command"]
    assert "start" in capsys.readouterr().out


def test_every_column_says_what_it_means(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
):
    text = 'duration = 0.01\nsettle = 0.005\nepisodes = 1\ncontroller = "pd"\n'
    text += '[grid]\narm = ["eth"]\nlayout = ["paper", "centred"]\nplant_modules = [4]\n'
    text += "[grid.disturbance]\npayload = [0.0, 0.1]\n"
    for field in schema(parse_spec(text)):
        said = {key.decode(): word.decode() for key, word in field.metadata.items()}
        assert said["text"]
        if said.get("metric"):
            assert said["unit"] and said["better"] in ("less", "more", "neither", "nearer to zero")
    assert schema(parse_spec(text)).field("payload").metadata[b"unit"] == b"kg"
    assert main(["report", "--columns"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].split() == ["column", "unit", "better", "meaning"]
    (tip,) = (line for line in lines if line.startswith("tip_rms_error "))
    unit, better, text = tip.split(maxsplit=3)[1:]
    assert (unit, better) == ("m", "less") and METRICS["tip_rms_error"].text.startswith(text)
    assert max(map(len, lines)) <= 100
    again = " ".join(" ".join(lines).split())
    assert all(METRICS[name].text in again for name in ("overshoot", "chattering", "work"))
    with monkeypatch.context() as wide:
        wide.setenv("COLUMNS", "150")
        assert main(["report", "--columns"]) == 0
    assert 100 < max(map(len, capsys.readouterr().out.splitlines())) <= 150
    Path("spec.toml").write_text('duration = 0.01\nepisodes = 1\ncontroller = "pd"\n')
    assert main(["sweep", "spec.toml", "--out", "s", "--workers", "1"]) == 0
    table = octarm.read_sweep("s")
    assert [line.split()[0] for line in lines[1:] if line[0] != " "] == table.column_names
    assert table.schema.field("overshoot_theta1").metadata[b"better"] == b"nearer to zero"
    capsys.readouterr()
    assert main(["report", "s", "--columns"]) == 0
    assert capsys.readouterr().out.splitlines() == lines
    assert not Path("s/report").exists()

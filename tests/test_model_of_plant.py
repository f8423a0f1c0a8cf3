"""A plant of its own file, and a controller's model of fewer modules from another one."""

import functools
import json
from pathlib import Path

import numpy as np
import pytest

import octarm
from controllers import make_controller
from octarm.arm.file import Arm, arm_toml
from octarm.arm.groups import groups_of
from octarm.arm.rod import Rod, arm_from_rod, lumped
from octarm.checks.stability import linear_plant, loop_at_rest
from octarm.commands.cli import main
from octarm.disturbances.varied import parse_varied
from octarm.sweeps.margin import MarginRuns
from octarm.sweeps.spec_file import parse_spec, read_spec

FACTORY = functools.partial(make_controller, gain_set="recommended")
ROD, MODEL = arm_from_rod(Rod(), 9), arm_from_rod(Rod(EI=0.3), 3)
STEPS = ["--timestep", "0.0001", "--control-period", "0.0001", "--gains", "recommended"]
WORDS = ["--arm", "rod.toml", "--model", "model.toml", "--controller", "pd"]


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)
    centred = arm_from_rod(Rod(), 3, "centred")
    arms = {"rod": ROD, "model": MODEL, "centred": centred, "two": arm_from_rod(Rod(), 2)}
    for name, arm in arms.items():
        Path(f"{name}.toml").write_text(arm_toml(Arm(arm)), encoding="utf-8")


@pytest.mark.parametrize("sensing", ["groups", "plates"])
def test_a_uniform_rod_in_groups_is_the_split_of_its_lumped_arm(sensing: str):
    few = arm_from_rod(Rod(), 3)
    rest = {"timestep": 1e-4, "sensing": sensing, "engine": "lagrange"}
    runs = [
        octarm.rollout(octarm.load(**rest, **plant), FACTORY("pd", few), 0.05)
        for plant in ({"parameters": ROD, "groups": 3}, {"parameters": few, "plant_modules": 9})
    ]
    for name in ("q", "v", "tau", "q_d"):
        np.testing.assert_allclose(*(getattr(run, name) for run in runs), rtol=1e-7, atol=1e-7)


def test_a_rigid_piece_at_the_end_makes_it_a_plant_of_the_layout_centred():
    split = groups_of(arm_from_rod(Rod(), 3), 9, "centred")
    given = groups_of(arm_from_rod(Rod(), 9, "centred"), groups=3)
    assert split is not None and given is not None and given.layout == "centred"
    for name in ("matrix", "offset", "beyond"):
        np.testing.assert_allclose(getattr(given, name), getattr(split, name), atol=1e-12)
    q = np.random.default_rng(1).normal(size=18)
    np.testing.assert_allclose(given.tip(q), split.tip(q))
    np.testing.assert_allclose(given.plant.stiffness, split.plant.stiffness)


def test_groups_of_an_uneven_plant_are_measured_and_moved_by_virtual_work():
    uneven = ROD.scaled(mass=np.linspace(0.5, 1.5, 9), stiffness=np.linspace(2.0, 0.7, 9))
    groups = groups_of(uneven, groups=3)
    assert groups is not None
    q, force = np.random.default_rng(0).normal(size=(2, 18))
    power = groups.force(force[:6]) @ q
    assert power == pytest.approx(force[:6] @ groups.rates(q))
    np.testing.assert_array_equal(groups.plant.mass, uneven.mass)
    np.testing.assert_allclose(groups.arm.mass, uneven.mass.reshape(3, 3).sum(axis=1))
    assert groups_of(uneven) is None and groups_of(uneven, groups=9) is None


def test_a_run_has_the_plant_and_the_model_and_comes_out_again(capsys):
    run = ["run", *WORDS, *STEPS, "--duration", "0.02", "--disturbance", "noise:0.4"]
    assert main([*run, "--mismatch", "0.1", "--out", "a"]) == 0
    assert "a plant of 9 modules (paper)" in capsys.readouterr().out
    said = json.loads(Path("a/run.json").read_text(encoding="utf-8"))
    assert said["plant"]["parameters"]["mass"] == pytest.approx(ROD.mass)
    assert said["nominal"]["mass"] == pytest.approx(1.1 * MODEL.mass)
    assert said["parameters"]["mass"] == pytest.approx(lumped(ROD, 3).mass)
    arrays, _ = octarm.read_run("a")
    assert arrays.q.shape[-1] == 6 and arrays.signals["plant_q"].shape[-1] == 18
    assert main(["verify", "a"]) == 0
    assert main(["record", "a", "--out", "again.rrd"]) == 0


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (("--model", "two.toml"), "2 groups were to be made of 9 modules"),
        (("--model", "centred.toml"), "the model ends with a rigid piece, as in the layout"),
        (("--model", "model.toml", "--plant-modules", "9"), "without plant_modules or layout"),
        (("--model", "model.toml", "--layout", "centred"), "without plant_modules or layout"),
        (("--model", "modl.toml"), "modl.toml cannot be read"),
    ],
)
def test_what_is_no_model_of_the_arm_is_one_sentence(words, sentence: str, capsys):
    assert main(["run", "--arm", "rod.toml", *words, *STEPS]) == 2
    assert sentence in capsys.readouterr().err
    assert main(["tune", "pd", "--model", "model.toml"]) == 2
    assert "--model is given" in capsys.readouterr().err


def test_a_model_of_as_many_modules_is_what_the_controller_believes(capsys):
    plain = ["run", "--model", "model.toml", "--duration", "0.01"]
    assert main([*plain, "--controller", "pd", "--out", "a"]) == 0
    said = json.loads(Path("a/run.json").read_text(encoding="utf-8"))
    assert "plant" not in said and said["nominal"]["mass"] == MODEL.mass.tolist()
    assert said["parameters"]["mass"] == octarm.nominal_parameters().mass.tolist()


SPEC = """
controller = "pd"
arm = "rod.toml"
model = "model.toml"
gain_set = "recommended"
duration = 0.02
timestep = 0.0001
mismatch = 0.1
engine = "lagrange"
"""


def test_a_sweep_has_the_model_in_its_spec_and_its_episodes_are_those_runs(capsys):
    Path("spec.toml").write_text(SPEC, encoding="utf-8")
    spec = read_spec("spec.toml")
    assert parse_spec(spec.to_toml()).hash() == spec.hash()
    assert spec.hash() != read_spec_without_model().hash()
    assert main(["sweep", "spec.toml", "--out", "s", "--workers", "1"]) == 0
    for name in ("rod", "model"):
        Path(f"{name}.toml").unlink()
    assert main(["verify", "s", "--episode", "0"]) == 0
    table = octarm.read_sweep("s").to_pylist()[0]
    law = FACTORY("pd", MODEL.mismatched(0.1))
    environment = octarm.load(parameters=ROD, groups=3, timestep=1e-4, engine="lagrange")
    run = octarm.rollout(environment, law, 0.02)
    assert table["peak_input_tau1"] == pytest.approx(np.abs(run.tau[:, 0]).max(), rel=1e-6)


def read_spec_without_model():
    return parse_spec(SPEC.replace('model = "model.toml"', "").replace("rod.toml", "eth"))


@pytest.mark.parametrize(
    ("old", "new", "sentence"),
    [
        ("model.toml", "modl.toml", "line 4: "),
        ("model.toml", "two.toml", "line 4: 2 groups were to be made of 9 modules"),
        ("model.toml", "centred.toml", "line 4: the model ends with a rigid piece"),
    ],
)
def test_a_spec_names_the_line_of_a_wrong_model(old: str, new: str, sentence: str, capsys):
    Path("spec.toml").write_text(SPEC.replace(old, new), encoding="utf-8")
    assert main(["sweep", "spec.toml", "--dry-run"]) == 2
    assert sentence in capsys.readouterr().err


def test_margins_and_loops_are_those_of_the_plant_and_the_model(capsys):
    runs = MarginRuns(
        factory=lambda nominal: FACTORY("pd", nominal), varied=parse_varied("payload", "0", "0.1"),
        bounds=[("tip_rms_error", 1.0)], duration=0.02, settle=0.0, timestep=1e-4,
        parameters=ROD, model=MODEL, engine="lagrange",
    ).rehearse()  # fmt: skip
    attempt = runs(np.array([0]), np.array([0.0]))
    environment = octarm.load(parameters=ROD, groups=3, timestep=1e-4, engine="lagrange")
    run = octarm.rollout(environment, FACTORY("pd", MODEL), 0.02)
    assert np.isfinite(attempt.excess).all() and run.status == "ok"

    loop = loop_at_rest(linear_plant(ROD, groups_of(ROD, groups=3)), FACTORY("pd", MODEL), 5e-4)
    words = ["--controller", "pd", "--gains", "recommended", "--control-period", "0.0001"]
    assert main(["arm", "rod.toml", "--model", "model.toml", *words]) == 0
    out = capsys.readouterr().out
    assert "the model model.toml, on a plant of 9 modules (paper)" in out
    assert f"{1e3 * loop.longest:.3g} ms" in out

"""Plants of more modules on the command line, in recordings, sweeps, margins and tuning."""

import functools
import json
from pathlib import Path

import numpy as np
import pytest
from recordings import column, entities
from small_tuning import BUDGET

import octarm
from controllers import make_controller
from octarm.arm.groups import Groups
from octarm.arm.kinematics import arc_tip, positions
from octarm.arm.mjcf import nominal_parameters, world_position
from octarm.commands.cli import main
from octarm.disturbances.varied import parse_varied
from octarm.errors import OctarmError
from octarm.metrics.table import Metrics
from octarm.runs import folder as runs
from octarm.simulation.environment import load
from octarm.simulation.rollout import rollout
from octarm.sweeps.margin import MarginRuns
from octarm.sweeps.plan import Plan, with_step
from octarm.sweeps.scenarios import SCENARIOS, Examination
from octarm.sweeps.shards import run_arms, run_shard
from octarm.sweeps.spec_file import parse_spec
from octarm.sweeps.tune import Budget
from octarm.sweeps.tune_cost import Rig, costs

ARM = nominal_parameters()
SHORT = [
    "run",
    "--duration",
    "0.02",
    "--timestep",
    "0.0001",
    "--gains",
    "recommended",
    "--out",
    "a",
]
FACTORY = functools.partial(make_controller, gain_set="recommended")


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize(("engine", "sensing"), [("mujoco", "groups"), ("lagrange", "plates")])
def test_a_run_says_which_plant_it_was_and_comes_out_again(engine: str, sensing: str, capsys):
    acting = ["--disturbance", "noise:0.4", "--disturbance", "pulse:1,on=tip-x,length=1"]
    of_plant = ["--plant-modules", "15", "--layout", "centred", "--engine", engine]
    assert main([*SHORT, *of_plant, *acting, "--sensing", sensing]) == 0
    out = capsys.readouterr().out
    read = "" if sensing == "groups" else ", read by plates"
    assert f"smc-boundary on sine, a plant of 15 modules (centred{read}): " in out
    run, description = runs.read_run(Path("a"))
    groups = Groups.of(ARM, 15, "centred")
    assert description["plant"]["modules"] == 15 and description["plant"]["layout"] == "centred"
    assert description["plant"]["sensing"] == sensing
    assert ("q_measured" in run.signals) == (sensing == "plates")
    given = description["plant"]["map"]
    np.testing.assert_array_equal(given["matrix"], groups.matrix)
    np.testing.assert_array_equal(given["offset"], groups.offset)
    believed = run.signals["plant_q"] @ groups.matrix.T + groups.offset
    np.testing.assert_allclose(run.q, believed, rtol=1e-12, atol=1e-15)
    assert main(["verify", "a"]) == 0
    assert "identical" in capsys.readouterr().out
    changed = json.loads(Path("a/run.json").read_text())
    changed["plant"] |= {"layout": "paper"} if sensing == "groups" else {"sensing": "groups"}
    Path("a/run.json").write_text(json.dumps(changed))
    assert main(["verify", "a"]) == 1


def test_a_recording_has_the_true_curve_beside_the_believed_one():
    assert main([*SHORT, "--plant-modules", "9"]) == 0
    run, description = runs.read_run(Path("a"))
    assert "world/plant" in {name.strip("/") for name in entities("a/run.rrd")}
    curve = column("a/run.rrd", "/world/plant", "LineStrips3D:strips").reshape(-1, 11, 3)
    plates = world_position(positions(run.signals["plant_q"]))
    np.testing.assert_allclose(curve[0, 1:10], plates[0], atol=1e-4)
    np.testing.assert_allclose(curve[0, -1], world_position(run.signals["plant_tip"])[0], atol=1e-4)
    assert main(["record", "a", "--out", "again.rrd"]) == 0 and main(["plot", "a"]) == 0
    assert description["metrics"]["tip_rms_error"] is None  # too short a run
    assert main([*SHORT[:-1], "b"]) == 0
    assert "plant" not in runs.read_run(Path("b"))[1]
    assert "world/plant" not in {name.strip("/") for name in entities("b/run.rrd")}


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        (("--plant-modules", "10"), "the plant is to have 10 modules; it must be a multiple of"),
        (("--plant-modules", "0"), "plant-modules is 0; it must be at least 1"),
        (("--layout", "centred"), "plant_modules must say of how many"),
        (("--sensing", "plates"), "sensing is 'plates', that of a plant of more modules"),
        (("--plant-modules", "9", "--layout", "papr"), "unknown layout 'papr', did you mean 'pa"),
        (("--plant-modules", "30"), "timestep is 0.0001 s; the fastest mode of the arm decays at"),
    ],
)
def test_a_plant_that_cannot_be_is_refused_in_a_sentence(options, sentence: str, capsys):
    assert main([*SHORT, *options]) == 2
    out, err = capsys.readouterr()
    assert out == "" and sentence in err and len(err.strip().splitlines()) == 1
    assert not list(Path().iterdir())


def test_the_tip_error_is_that_of_the_true_tip_against_arcs():
    environment = load("set-point", plant_modules=9, timestep="auto", control_period=1e-3)
    run = rollout(environment, FACTORY("computed-torque", ARM), 2.2)
    metrics = Metrics(control_period=1e-3)
    metrics.update(dict(run.arrays()))
    tips, q_d = (run.signals[f"{name}_steps"] for name in ("plant_tip", "q_d"))
    np.testing.assert_array_equal(tips[:, 0], run.signals["plant_tip"])
    steps = tips.shape[1]
    assert steps * environment.physics.timestep() == pytest.approx(1e-3)
    first = 2000 * steps  # of the steady regime, which begins at 2 s
    x, y = arc_tip(q_d.reshape(-1, 6)[first:])
    distance = np.hypot(*(tips.reshape(-1, 2)[first:] - np.stack([x, y], -1)).T)
    assert metrics.result()["tip_peak_error"] == pytest.approx(np.max(distance), rel=1e-12)


SPEC = """\
episodes = 2
duration = 0.02
timestep = "auto"
control_period = 2e-4
controller = "smc-boundary"
engine = "{engine}"
[grid]
plant_modules = [3, 9, 15]
layout = ["paper", "centred"]
mismatch = [-0.3, 0.0]
[grid.disturbance]
noise = [0.0, 0.4]
[disturbance]
payload = 0.1
step = {{ amplitude = 1.0, on = "tip-y" }}
"""


def comparable(table):
    varying = {"wall_time", "engine_difference"} & set(table.column_names)
    return table.drop_columns([*varying]).replace_schema_metadata(None)


@pytest.mark.parametrize("engine", ["mujoco", "lagrange"])
def test_sizes_of_the_plant_are_an_axis_of_sweeps(engine: str):
    spec = with_step(parse_spec(SPEC.format(engine=engine)))
    assert spec.timestep == pytest.approx(2e-4)
    plan = Plan(spec)
    assert [axis.name for axis in spec.axes] == [
        "controller", "reference", "layout", "plant_modules", "mismatch", "noise",
    ]  # fmt: skip
    assert plan.episodes == 48 and len(plan.shards) == 6
    for shard, (layout, modules) in enumerate(
        (layout, n) for layout in ("paper", "centred") for n in (3, 9, 15)
    ):
        if modules == 9 and engine == "mujoco":
            continue
        whole = run_shard(spec, shard, FACTORY)
        table = comparable(whole)
        assert set(table["plant_modules"].to_pylist()) == {modules}
        assert set(table["layout"].to_pylist()) == {layout}
        number = plan.shard(shard)[5]
        alone = comparable(run_arms(plan, plan.episode(number), FACTORY))
        assert alone.equals(table.slice(5, 1))
        if engine == "lagrange":
            apart = whole["engine_difference"].drop_null().to_pylist()
            assert all(x < 1e-9 for x in apart)
    assert parse_spec(spec.to_toml()) == spec


def test_what_is_read_is_an_axis_of_sweeps():
    text = """controller = "pd"\nduration = 0.02\ntimestep = 2e-4\nengine = "lagrange"
plant_modules = 9\n[grid]\nsensing = ["groups", "plates"]\n[disturbance]\npayload = 0.1\n"""
    spec = parse_spec(text)
    plan, digests = Plan(spec), []
    assert plan.episodes == 2 and parse_spec(spec.to_toml()) == spec
    for shard, sensing in enumerate(("groups", "plates")):
        table = run_shard(spec, shard, FACTORY)
        assert table["sensing"].to_pylist() == [sensing]
        options = {"plant_modules": 9, "timestep": 2e-4, "engine": "lagrange", "sensing": sensing}
        alone = comparable(run_arms(plan, plan.episode(shard), FACTORY))
        assert alone.equals(comparable(table))
        digests += table["digest"].to_pylist()
        assert load(**options).physics.groups.sensing == sensing
    assert digests[0] != digests[1]
    with pytest.raises(OctarmError, match=r"line 2: sensing is 'plates', that of a plant of more"):
        parse_spec('controller = "pd"\nsensing = "plates"\n')
    with pytest.raises(OctarmError, match=r"unknown.*plate|plate.*groups"):
        parse_spec('controller = "pd"\nplant_modules = 9\nsensing = "plate"\n')


def test_a_step_that_is_too_long_for_one_plant_of_a_sweep_is_refused():
    text = 'controller = "pd"\n[grid]\nplant_modules = [3, 30]\n'
    with pytest.raises(OctarmError, match=r"episode 1: timestep is 0\.0005 s; the fastest mode"):
        with_step(parse_spec(text))
    auto = with_step(parse_spec('timestep = "auto"\n' + text))
    assert auto.timestep == pytest.approx(5e-5)


def test_a_spec_without_plants_is_what_it_was():
    spec = parse_spec('controller = "pd"\n')
    assert [axis.name for axis in spec.axes] == ["controller", "reference", "mismatch"]
    assert not any("plant" in key or "layout" in key for key in spec.content())


@pytest.mark.parametrize(
    ("text", "sentence"),
    [
        ("plant_modules = 10\n[grid]\n", "spec.toml, line 1: the plant is to have 10 modules"),
        ("[grid]\nplant_modules = [3, 10]\n", "spec.toml, line 2: the plant is to have 10"),
        ("[grid]\nlayout = ['centred']\n", "line 2: layout is 'centred', that of a plant of"),
        ("[grid]\nlayout = ['central']\n", "line 2: unknown layout"),
        ("plant_modules = 9\n[grid]\nplant_modules = [3]\n", "plant_modules is given twice"),
        ("[grid]\nplant_modules = [4.5]\n", "line 2: plant_modules"),
    ],
)
def test_a_spec_with_a_plant_that_cannot_be_is_refused(text: str, sentence: str):
    with pytest.raises(OctarmError, match=sentence):
        parse_spec(text + "controller = ['pd']\n")


def test_a_sweep_is_written_verified_and_reported(capsys):
    Path("s.toml").write_text(
        'controller = "pd"\nduration = 0.02\nengine = "lagrange"\n[grid]\nplant_modules = [3, 6]\n'
        "[record]\nepisodes = [1]\n"
    )
    assert main(["sweep", "s.toml", "--out", "s", "--workers", "1"]) == 0
    assert octarm.read_sweep("s")["plant_modules"].to_pylist() == [3.0, 6.0]
    assert main(["verify", "s", "--episode", "1"]) == 0
    (recorded,) = Path("s/recorded").iterdir()
    assert runs.read_description(recorded)["plant"]["modules"] == 6
    assert main(["verify", str(recorded)]) == 0
    assert main(["report", "s", "--metric", "effort"]) == 0
    assert "plant_modules" in Path("s/report/report.html").read_text()


def test_margins_are_those_of_the_plant():
    varied = parse_varied("step:on=tip-y", 0.0, 5.0)
    excess = []
    for modules in (None, 9):
        run = MarginRuns(
            factory=lambda nominal: FACTORY("pd", nominal),
            varied=varied,
            bounds=[("peak_error_theta3", 1e-3)],
            reference="set-point",
            duration=2.2,
            timestep="auto",
            control_period=1e-3,
            plant_modules=modules,
            engine="lagrange",
        ).rehearse()
        excess.append(run(np.zeros(2, dtype=int), np.array([0.0, 1.0])).excess)
    # A load on the tip has no lever to the last hinge of the arm, but to those of its last group.
    assert excess[1][1] > 10.0 * excess[0][1] > 0.0


def test_tuning_tries_the_plant():
    trial = Examination(begin=0.01, duration=0.02)
    gains = {"K": np.array([[1.0], [3.0]])}
    factory = functools.partial(make_controller, "smc", gain_set="recommended")
    tried = [costs([trial], factory, gains, rig=Rig("lagrange", n))[0] for n in (None, 3, 9)]
    assert tried[0].shape == (2, len(SCENARIOS))
    others = [not scenario.plant_modules for scenario in SCENARIOS]
    assert np.all((tried[2] != tried[0])[:, others])
    np.testing.assert_array_equal(tried[0], tried[1])
    assert Rig("lagrange").settings() == {"engine": "lagrange"}


def test_a_gain_file_says_for_which_plant_its_gains_are(capsys, monkeypatch):
    monkeypatch.setattr(Budget, "within", classmethod(lambda cls, seconds: BUDGET))
    options = ["--workers", "1", "--plant-modules", "6", "--layout", "centred", "--out", "g.toml"]
    assert main(["tune", "pd", *options]) == 0
    text = Path("g.toml").read_text()
    assert "plant_modules = 6" in text and 'layout = "centred"' in text
    assert "--plant-modules=6 --layout=centred" in text

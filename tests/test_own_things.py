"""Controllers, references, disturbances and metrics by import path, file and entry point."""

import contextlib
import importlib.metadata
import json
import os
import subprocess
import sys
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from own_things import GUST, LAW, MOTION, REACH, write_things
from recordings import fields
from small_tuning import BUDGET

import octarm
from controllers import CONTROLLERS, make_controller
from controllers.law import gain_fields
from octarm import importing
from octarm.commands import cli
from octarm.declared import Code, CodeChanged, named, word_of
from octarm.disturbances.spelling import DISTURBANCES, parse_disturbance, spelling
from octarm.disturbances.varied import is_varied, parse_varied
from octarm.errors import OctarmError
from octarm.metrics.table import ACCUMULATORS
from octarm.references import REFERENCES, named_reference
from octarm.runs import folder as runs
from octarm.sweeps.spec_file import parse_spec, read_spec
from octarm.sweeps.store import open_sweep
from octarm.sweeps.tune import Budget

P = octarm.nominal_parameters()
RUN = (
    "run", "--controller", "./damper.py:Damper", "--reference", "./swing.py:Swing",
    "--disturbance", "./gust.py:Gust:4,at=0.05", "--metric", "./reach.py:Reach",
    "--duration", "0.1", "--gain", "pull:300",
)  # fmt: skip


@pytest.fixture(autouse=True)
def things(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder outside the checkout, in which the commands are run."""
    folder = write_things(tmp_path / "mine")
    monkeypatch.chdir(folder)
    return folder


def said(*words: str) -> tuple[int, str]:
    """The exit code of a command and its one line of errors."""
    err = StringIO()
    with contextlib.redirect_stderr(err):
        code = cli.main(words)
    return code, err.getvalue().removeprefix("octarm: ").rstrip()


def module(folder: Path, name: str) -> str:
    """The damper as a module of a package; returns its import path."""
    package = folder / name
    package.mkdir()
    (package / "__init__.py").write_text(f"raise SystemError('{name} was imported')")
    (package / "laws.py").write_text(LAW)
    return f"{name}.laws:Damper"


def test_a_run_records_what_it_used_and_is_verified(things: Path, capsys):
    assert cli.main([*RUN, "--out", "run"]) == 0
    out = capsys.readouterr().out
    assert out.startswith("Damper on Swing: 0.1 s")
    assert "  gust:4,at=0.05 -> " in out
    written = json.loads(Path("run/run.json").read_text())
    assert written["controller"] == {"name": "Damper", "gains": {"K_v": 4.0, "pull": 300.0}}
    assert written["reference"]["name"] == "Swing"
    assert [entry["name"] for entry in written["disturbances"]] == ["gust"]
    assert written["metrics"]["largest_bend"] > 0.0
    code = written["code"]
    assert {name: code[name]["kind"] for name in code} == {
        "Damper": "controller", "Swing": "reference", "gust": "disturbance", "Reach": "metric",
    }  # fmt: skip
    assert code["Damper"]["path"] == f"{things}/damper.py:Damper"
    for name, file in (("Damper", "damper.py"), ("gust", "gust.py")):
        assert code[name]["sha256"] == importing.sha256_of(Path(file).read_bytes())
    assert cli.main(["verify", "run"]) == 0
    assert "identical" in capsys.readouterr().out


@pytest.mark.parametrize("file", ["damper.py", "swing.py", "gust.py", "reach.py"])
@pytest.mark.parametrize("gone", [False, True])
def test_verify_says_that_code_changed_and_runs_none_of_it(file: str, gone: bool, capsys):
    assert cli.main([*RUN, "--out", "run"]) == 0
    if gone:
        Path(file).unlink()
    else:
        Path(file).write_text("open('ran', 'w')\n" + Path(file).read_text())
    capsys.readouterr()
    assert cli.main(["verify", "run"]) == 1
    out, err = capsys.readouterr()
    assert file in out and ("cannot be read" if gone else "was changed") in out
    assert err == "" and not Path("ran").exists()


def test_parameters_stand_behind_a_motion_of_ones_own(capsys):
    words = [w.replace(":Swing", ":Swing:amplitude=4deg") for w in RUN]
    assert cli.main([*words, "--out", "run"]) == 0
    assert capsys.readouterr().out.startswith("Damper on Swing:amplitude=4deg: 0.1 s")
    bends = octarm.read_run("run")[0].q_d[:, 3:]
    assert np.ptp(bends) > 0.0 and np.abs(bends).max() < np.deg2rad(4.0)
    assert cli.main(["verify", "run"]) == 0
    words = [w.replace(":Swing", ":Swing:ampitude=4deg") for w in RUN]
    code, text = said(*words)
    assert code == 2 and "ampitude" in text and "amplitude" in text


def test_looking_at_results_imports_nothing(things: Path, capsys):
    assert cli.main([*RUN, "--out", "run"]) == 0
    for file in things.glob("*.py"):
        file.write_text("raise SystemError('it was imported')")
    assert cli.main(["record", "run", "--out", "again.rrd"]) == 0
    assert cli.main(["plot", "run"]) == 0
    for name, rows in fields("run/run.rrd", "/signals").items():
        np.testing.assert_array_equal(fields("again.rrd", "/signals")[name], rows)
    assert octarm.read_run("run")[1]["controller"]["name"] == "Damper"


def test_a_file_within_the_folder_that_is_verified_is_not_run(capsys):
    assert cli.main([*RUN, "--out", "run"]) == 0
    inner = Path("run/damper.py")
    inner.write_text(LAW)
    text = Path("run/run.json").read_text()
    Path("run/run.json").write_text(text.replace("mine/damper.py", "mine/run/damper.py"))
    assert cli.main(["verify", "run"]) == 2
    assert "is within the folder that is to be verified; it is not run" in capsys.readouterr().err


def test_a_folder_cannot_name_code_that_it_does_not_record(capsys):
    command = ["run", "--controller", "pd", "--duration", "0.005", "--out", "run"]
    assert cli.main(command) == 0
    text = Path("run/run.json").read_text()
    for old, new in (('"pd"', '"./damper.py:Damper"'), ('"sine"', '"./swing.py:Swing"')):
        Path("run/run.json").write_text(text.replace(old, new, 1))
        Path("damper.py").write_text("open('ran', 'w')")
        capsys.readouterr()
        assert cli.main(["verify", "run"]) == 2
        assert "cannot be run again" in capsys.readouterr().err
        assert not Path("ran").exists()


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("--controller ./damper.py", "controller is './damper.py'; it must be a known name, MOD"),
        ("--controller ./dampr.py:Damper", "mine/dampr.py cannot be read: No such"),
        ("--controller ./damper.py:Dampr", "holds no 'Dampr', did you mean 'Damper'?"),
        ("--controller no_lab.laws:Law", "there is no module 'no_lab.laws'; it must be"),
        ("--controller ./gust.py:Gust", "Gust is no controller of octarm: it has no method in"),
        ("--controller ./reach.py:Reach", "it is no dataclass; octarm.interfaces.Contr"),
        ("--controller ./broken.py:Law", "broken.py cannot be imported: SyntaxError: "),
        ("--controller ./leaves.py:Law", "leaves.py cannot be imported: SystemExit: 3"),
        ("--controller ./thawed.py:Damper", "is no frozen dataclass, although"),
        ("--controller ./needy.py:Damper", "Damper needs the gain pull; it recommends no value"),
        ("--controller ./misfit.py:Damper", "has a method initial_state that does not"),
        ("--controller ./damper.py:Damper --gain pull:1,2,3", "pull has 3 values; it needs 1 or 6"),
        ("--disturbance ./idle.py:Gust:5", "Gust is no disturbance of octarm: it has no method st"),
        ("--metric ./idler.py:Reach", "Reach is no metric of octarm: it has no method result"),
        ("--controller ./damper.txt:Damper", "it must be a known name, MOD"),
        ("--controller damper", "unknown controller 'damper'; known are pd, "),
        ("--reference ./gust.py:Gust", "Gust is no reference of octarm: it cannot"),
        ("--reference ./rests.py:rest", "makes array("),
        ("--reference ./rests.py:late", "the reference answers 1.0 at t = 0 s"),
        ("--disturbance ./damper.py:Damper:5", "is no Force, PlantChange, Act"),
        ("--disturbance ./gust.py:Gust", "is incomplete; it must read gust:SPEED,c=0.01,at=0"),
        ("--disturbance ./gust.py:Gust:50", "speed of gust is 50 m/s; it must be at most 40 m/s"),
        ("--disturbance ./gust.py:Gust:5,x=1", "gust has no key 'x'"),
        ("--disturbance ./noise.py:Gust:5", "has the name noise, which is that of a built-in one"),
        ("--disturbance ./second.py:Gust:5", "has the name 'gust-2'; it must be"),
        ("--disturbance ./bare.py:Gust:5", "needs fields annotated with Quantity or Words"),
        ("--metric ./damper.py:Damper", "is no metric of octarm: it is no Accumulator of"),
        ("--metric ./rms.py:Reach", "declares rms_error, which is measured anyway"),
        ("--metric largest_bend", "unknown metric 'largest_bend'; the nearest of"),
        ("--controller ./damper.py:Damper --gain pul:3", "did you mean 'pull'? known"),
        ("--controller ./damper.py:Damper --gain K_v:-3", "K_v holds -3; it must be above 0"),
        ("--controller ./damper.py:Damper --gains tuned", "Damper comes without tuned gains"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_one_sentence(things: Path, words: str, sentence: str, capsys):
    for name, text in {
        "broken.py": "class Law(:",
        "leaves.py": "raise SystemExit(3)",
        "thawed.py": LAW.replace("frozen=True, ", ""),
        "needy.py": LAW.replace("pull: float = 200.0", "pull: float"),
        "misfit.py": LAW.replace("(self, batch_shape=())", "(self)"),
        "idle.py": GUST.replace("def start", "def begin"),
        "idler.py": REACH.replace("def result", "def results"),
        "rests.py": "def rest(q):\n    return q\n\n\ndef late(q):\n    return lambda t: 1.0\n",
        "noise.py": GUST.replace('"gust"', '"noise"'),
        "second.py": GUST.replace('"gust"', '"gust-2"'),
        "bare.py": GUST.replace('Annotated[Amount, Quantity("s", at_least=0.0)]', "float"),
        "rms.py": Path("reach.py").read_text().replace("largest_bend", "rms_error"),
    }.items():
        (things / name).write_text(text)
    assert cli.main(["run", *words.split(), "--duration", "0.005", "--out", "run"]) == 2
    out, err = capsys.readouterr()
    (line,) = err.splitlines()
    assert sentence in line and out == ""
    assert not Path("run").exists()


def test_a_spec_says_where_its_code_is_wrong(things: Path):
    good = Path("spec.toml").read_text()
    for old, new, sentence in (
        ("./reach.py:Reach", "./reach.py:Reech", "spec.toml, line 7: .* holds no 'Reech'"),
        ("./swing.py:Swing", "./swing.py:Swings", "spec.toml, line 11: .* holds no 'Swings'"),
        ('[grid.disturbance]\n"./gust.py', '[grid.disturbance]\n"./gast.py', "line 14: .*gast.py"),
        ("[0.0, 3.0]", "[0.0, 90.0]", "speed of gust is 90 m/s; it must be at most 40 m/s"),
        ("K_v = 3.0", "K_w = 3.0", ""),
    ):
        assert good.count(old) == 1
        Path("spec.toml").write_text(good.replace(old, new))
        if sentence:
            with pytest.raises(OctarmError, match=sentence):
                read_spec("spec.toml")
        assert cli.main(["sweep", "spec.toml", "--out", "sweep"]) == 2
        assert not Path("sweep").exists()


def test_a_spec_gets_short_names_and_says_all_of_it_itself(things: Path, monkeypatch):
    monkeypatch.chdir("/")  # files are looked for beside the spec
    spec = read_spec(things / "spec.toml")
    assert spec.controllers == ("Damper", "pd")
    assert spec.references == ("Swing:amplitude=4deg", "sine")
    assert spec.disturbances == ("gust", "noise")
    assert [axis.name for axis in spec.axes] == [
        "controller", "reference", "mismatch", "gust",
    ]  # fmt: skip
    assert spec.gains == {"Damper": {"K_v": 3.0}}
    assert spec.fixed["gust"] == {"drag": 0.02}
    assert {*spec.metrics()} - {*octarm.metrics.table.METRICS} == {"largest_bend"}
    for file in things.glob("*.py"):
        file.write_text("raise SystemError('it was imported')")
    again = parse_spec(spec.to_toml())
    assert again == spec and again.hash() == spec.hash()
    with pytest.raises(CodeChanged):
        again.controller("Damper", P, make_controller)


def test_a_spec_knows_a_second_disturbance_of_the_same_class():
    text = 'controller = "pd"\n[disturbance]\n"./gust.py:Gust" = 1\n"./gust.py:Gust-2" = {speed=2}'
    Path("two.toml").write_text(text)
    spec = read_spec("two.toml")
    assert spec.fixed == {"gust": {"speed": 1.0}, "gust-2": {"speed": 2.0}}
    assert parse_spec(spec.to_toml()) == spec


def test_names_are_short_and_unique(things: Path):
    for place in ("v1", "v2"):
        write_things(things / place)
    (things / "pd.py").write_text(LAW.replace("Damper", "pd"))
    words = [
        (CONTROLLERS, f"{things}/v1/damper.py:Damper"),
        (CONTROLLERS, f"{things}/v2/damper.py:Damper"),
        (CONTROLLERS, f"{things}/pd.py:pd"),
        (CONTROLLERS, "pd"),
        (REFERENCES, f"{things}/swing.py:Swing"),
        (DISTURBANCES, f"{things}/gust.py:Gust"),
    ]
    names, code = named(words)
    assert names == ["v1.damper.Damper", "v2.damper.Damper", "pd.pd", "pd", "Swing", "gust"]
    assert {*code} == {*names} - {"pd"}
    assert [word_of(name, code) for name in names] == [word for _, word in words]
    with pytest.raises(OctarmError, match="are both called gust; give one of them another name"):
        named([*words, (DISTURBANCES, f"{things}/v1/gust.py:Gust")])


def test_a_changed_file_is_read_anew():
    first = CONTROLLERS["./damper.py:Damper"]
    assert CONTROLLERS["./damper.py:Damper"] is first
    Path("damper.py").write_text(LAW.replace("200.0", "100.0"))
    second = CONTROLLERS["./damper.py:Damper"]
    assert second is not first
    assert (first.pull, second.pull) == (200.0, 100.0)
    assert not Path("__pycache__").exists()


def test_a_module_is_hashed_before_any_part_of_its_package_is_imported(things: Path, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    word = module(things, "my_loud_lab")
    wrong = Code(kind="controller", path=word, sha256="0" * 64)
    with pytest.raises(CodeChanged, match=f"{word} was changed since"):
        word_of("Damper", {"Damper": wrong})
    right = Code(kind="controller", path=word, sha256=importing.sha256_of(LAW.encode()))
    assert word_of("Damper", {"Damper": right}) == word
    assert "my_loud_lab" not in sys.modules
    with pytest.raises(OctarmError, match="SystemError: my_loud_lab was imported"):
        CONTROLLERS[word]


def test_a_module_in_the_working_folder_is_found_last(things: Path, monkeypatch):
    monkeypatch.setattr(sys, "path", [*sys.path])
    word = module(things, "my_lab")
    (things / "my_lab/__init__.py").write_text("")
    assert CONTROLLERS[word].__name__ == "Damper"
    assert sys.path[-1] == str(things)
    code = CONTROLLERS.code(word)
    assert code is not None and (code.path, code.distribution) == (word, "")


def test_an_installed_package_brings_names(things: Path, tmp_path: Path, monkeypatch, capsys):
    site = tmp_path / "site"
    write_things(site / "site_lab")
    (site / "site_lab/__init__.py").write_text("")
    info = site / "my_lab_octarm-1.2.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: my-lab-octarm\nVersion: 1.2\n")
    (info / "entry_points.txt").write_text(
        "[octarm.controllers]\ndamper = site_lab.damper:Damper\npd = site_lab.damper:Damper\n"
        "[octarm.references]\nswing = site_lab.swing:Swing\n"
        "[octarm.disturbances]\ngust = site_lab.gust:Gust\n"
        "[octarm.metrics]\nreach = site_lab.reach:Reach\n"
    )
    monkeypatch.setattr(sys, "path", [*sys.path, str(site)])
    importing.entry_points.cache_clear()
    importlib.invalidate_caches()
    try:
        assert CONTROLLERS.names()[-1] == "damper" and CONTROLLERS.names().count("pd") == 1
        assert CONTROLLERS["pd"] is not CONTROLLERS["damper"]  # what is built in comes first
        with contextlib.suppress(SystemExit):
            cli.main(["run", "--help"])
        text = " ".join(capsys.readouterr().out.split())
        assert "afsmc, damper, FILE.py:NAME" in text and "set-point, swing, FILE" in text
        assert "gust:SPEED,c=0.01,at=0 A wind that bends" in text
        words = "--controller damper --reference swing --disturbance gust:4 --metric reach"
        command = ["run", *words.split(), "--duration", "0.02", "--out", "run"]
        assert cli.main(command) == 0
        written = json.loads(Path("run/run.json").read_text())
        assert written["versions"]["my-lab-octarm"] == "1.2"
        assert {*written["code"]} == {"damper", "swing", "gust", "reach"}
        assert written["code"]["damper"]["path"] == "site_lab.damper:Damper"
        assert written["code"]["damper"]["distribution"] == "my-lab-octarm"
        assert cli.main(["verify", "run"]) == 0
        assert cli.main(["run", "--controller", "dampr"]) == 2
        assert "did you mean 'damper'" in capsys.readouterr().err
        Path("named.toml").write_text(
            'controller = ["damper"]\n'.replace("[", "").replace("]", "")
            + 'reference = "swing"\nmetric = "reach"\n[disturbance]\ngust = 1.0\n'
        )
        assert {*read_spec("named.toml").code} == {"swing", "gust", "reach"}
    finally:
        importing.entry_points.cache_clear()


def test_any_frozen_dataclass_is_a_controller_and_its_fields_are_its_gains():
    word = "./damper.py:Damper"
    law: Any = make_controller(word, P, {"pull": [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]})
    np.testing.assert_array_equal(law.pull, np.arange(1.0, 7.0))
    assert law.K_v == 4.0 and [*gain_fields(type(law))] == ["K_v"]
    plain: Any = make_controller(word, P)
    assert plain.pull == 200.0
    batch = octarm.load(batch=3)
    many = make_controller(word, P, {"K_v": np.full((3, 1), 2.0)})
    from octarm.simulation.rollout import simulate

    assert simulate(batch, many, 0.01) == ""


def test_a_law_without_a_model_or_with_other_fields(things: Path):
    text = LAW.replace(
        "    nominal: NominalModel\n", "    mode: str = 'soft'\n    count: int = 2\n"
    )
    text = text.replace("weight = self.nominal.potential_force(reference.q)", "weight = 0.0")
    (things / "plain.py").write_text(text)
    command = ["run", "--controller", "./plain.py:Damper", "--duration", "0.02", "--out", "run"]
    assert cli.main(command) == 0
    gains = json.loads(Path("run/run.json").read_text())["controller"]["gains"]
    assert gains == {"mode": "soft", "count": 2, "K_v": 4.0, "pull": 200.0}
    assert cli.main(["verify", "run"]) == 0


def test_a_reference_may_be_a_function(things: Path):
    text = (
        MOTION + "\n\ndef slow(rest):\n    motion = Swing(rest)\n    return lambda t: motion(t)\n"
    )
    (things / "swing.py").write_text(text)
    motion = named_reference("./swing.py:slow", np.zeros(6))
    np.testing.assert_allclose(motion(0.5).q, [0.0] * 3 + [0.1] * 3)
    command = ["run", "--reference", "./swing.py:slow", "--duration", "0.02", "--out", "run"]
    assert cli.main(command) == 0
    assert json.loads(Path("run/run.json").read_text())["reference"] == {"name": "slow"}
    assert cli.main(["verify", "run"]) == 0


def test_texts_of_disturbances_are_taken_apart():
    gust = parse_disturbance("./gust.py:Gust:5,c=0.02")
    assert spelling(gust) == "gust:5,c=0.02"
    for text, word, rest in (
        ("noise:0.4,time=1", "noise", "0.4,time=1"),
        ("/a b/x.py:Gust:5,at=1", "/a b/x.py:Gust", "5,at=1"),
        ("json.tool:Gust", "json.tool:Gust", ""),
        ("json:Gust:1/2", "json:Gust", "1/2"),
        ("nois:inf", "nois", "inf"),
    ):
        assert DISTURBANCES.split(text) == (word, rest)
    assert is_varied("./gust.py:Gust") and is_varied("./gust.py:Gust:c=1")
    assert not is_varied("./gust.py:Gust:5")
    varied = parse_varied("./gust.py:Gust:at=1", None, None)
    assert (varied.name, varied.low, varied.high, varied.unit) == ("gust", 0.0, 8.0, "m/s")


def test_a_metric_is_measured_once_however_it_is_given():
    assert ACCUMULATORS.code("rms_error") is None
    command = ["run", "--metric", "rms_error", "--duration", "0.005", "--out", "run"]
    assert cli.main(command) == 0
    assert json.loads(Path("run/run.json").read_text())["code"] == {}


def test_a_description_without_code_is_of_what_is_built_in():
    assert cli.main(["run", "--duration", "0.005", "--out", "run"]) == 0
    assert runs.read_description(Path("run"))["code"] == {}


def test_a_sweep_is_read_and_reported_without_its_code(things: Path, capsys):
    text = Path("spec.toml").read_text().replace('["worst"]', "[]")
    Path("spec.toml").write_text(text)
    from test_new_controller import Inline

    spec = read_spec("spec.toml")
    octarm.sweep(spec, make_controller, "sweep", executor=Inline(), in_flight=1)
    table = octarm.read_sweep("sweep")
    assert {*table["controller"].to_pylist()} == {"Damper", "pd"}
    assert {*table["reference"].to_pylist()} == {"Swing:amplitude=4deg", "sine"}
    assert min(table["largest_bend"].to_pylist()) > 0.0
    for file in things.glob("*.py"):
        file.write_text("raise SystemError('it was imported')")
    plan, manifest = open_sweep(Path("sweep"))
    assert plan.spec == spec and manifest["spec"]["code.gust"]["kind"] == "disturbance"
    for words in (["largest_bend"], ["./reach.py:Reach", "--baseline", "./damper.py:Damper"]):
        assert cli.main(["report", "sweep", "--force", "--metric", *words]) == 0
        assert "median largest_bend [rad]" in capsys.readouterr().out
    page = Path("sweep/report/report.html").read_text()
    assert "gust [m/s]" in page and "largest sum of all bends" in page
    assert cli.main(["verify", "sweep", "--episode", "3"]) == 1
    assert "reach.py:Reach was changed since" in capsys.readouterr().out
    assert cli.main(["sweep", "sweep/spec.toml", "--out", "again"]) == 2
    assert "was changed since" in capsys.readouterr().err


@pytest.mark.slow
def test_everything_by_the_command_line_and_the_same_table_however_it_is_run(
    things: Path, monkeypatch: pytest.MonkeyPatch
):
    """Two workers, dask, one process; then margin, tune, report, verify and a recording."""

    def octarm_(*words: str) -> str:
        command = [str(Path(sys.executable).parent / "octarm"), *words]
        done = subprocess.run(
            command, capture_output=True, text=True, env={**os.environ, "MUJOCO_GL": "disabled"}
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    def here(*words: str) -> str:
        out = StringIO()
        with contextlib.redirect_stdout(out):
            assert cli.main(words) == 0
        return out.getvalue()

    octarm_("sweep", "spec.toml", "--out", "one", "--workers", "1")
    octarm_("sweep", "spec.toml", "--out", "two", "--workers", "2")
    octarm_("sweep", "spec.toml", "--out", "dask", "--cluster", "local", "--workers", "2")
    octarm_("sweep", "two/spec.toml", "--out", "again", "--workers", "1")
    tables = [
        octarm.read_sweep(name).drop_columns("wall_time")
        for name in ("one", "two", "dask", "again")
    ]
    assert all(table.equals(tables[0]) for table in tables)
    assert len(list(Path("two/recorded").iterdir())) == 2
    assert "identical when run alone" in octarm_("verify", "two", "--sample", "2")
    assert "identical" in here("verify", str(next(Path("two/recorded").iterdir())))
    assert "Damper" in here("report", "two", "--metric", "largest_bend")
    margin = here(
        "margin", "./damper.py:Damper", "pd", "--disturbance", "./gust.py:Gust:c=0.05",
        "--disturbance", "noise:0.1", "--reference", "./swing.py:Swing",
        "--metric", "./reach.py:Reach", "--bound", "largest_bend:1.2", "--seeds", "2",
        "--duration", "0.3", "--settle", "0.1", "--timestep", "0.001", "--json", "margin.json",
    )  # fmt: skip
    assert margin.startswith("largest gust [m/s] of 0 .. 8 at which") and "--duration=0.3" in margin
    written = json.loads(Path("margin.json").read_text())
    assert {*written["code"]} == {"Damper", "gust", "Swing", "Reach"}
    monkeypatch.setattr(Budget, "within", classmethod(lambda cls, seconds: BUDGET))
    assert cli.main(["tune", "./damper.py:Damper", "--workers", "2"]) == 0
    assert 'controller = "Damper"' in Path("Damper.toml").read_text()
    run = ["run", "--controller", "./damper.py:Damper", "--duration", "0.05", "--out", "tuned"]
    assert cli.main([*run, "--gains", "Damper.toml"]) == 0
    assert cli.main(["verify", "tuned"]) == 0

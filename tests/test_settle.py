"""When the steady regime begins: in metrics, runs, sweeps, margins and reports."""

import json
from pathlib import Path

import numpy as np
import pytest

import octarm
from controllers import make_controller
from octarm.commands.cli import main
from octarm.metrics.metric import SETTLED_AFTER, unsettled
from octarm.metrics.table import Metrics
from octarm.sweeps.shards import measure
from octarm.sweeps.spec_file import parse_spec

STEP = 1.0 / 128.0  # exact in binary, and so are all times


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("settle", [0.0, 0.25, 1.0, SETTLED_AFTER])
def test_errors_count_from_there_on(settle: float):
    t = STEP * np.arange(384)
    q_d = np.zeros((len(t), 2))
    q = np.stack([np.exp(-t), np.cos(t)], axis=1)
    rows = {"t": t, "q": q, "q_d": q_d, "tau": q_d, "force": q_d}
    metrics = Metrics(control_period=STEP, settle=settle)
    for part in range(0, len(t), 50):  # however the run is cut
        metrics.update({name: x[part : part + 50] for name, x in rows.items()})
    found, late = metrics.result(), q[t >= settle]
    np.testing.assert_allclose(found["rms_error"], np.sqrt(np.mean(late**2, axis=0)), rtol=1e-13)
    np.testing.assert_array_equal(found["peak_error"], np.abs(late).max(axis=0))


def test_a_run_keeps_it_and_verify_repeats_it(capsys: pytest.CaptureFixture[str]):
    assert main(["run", "--duration", "0.2", "--settle", "50ms", "--out", "a"]) == 0
    out, err = capsys.readouterr()
    assert "after 0.05 s" in out and err == ""
    run, _ = octarm.read_run("a")
    description = json.loads(Path("a/run.json").read_text())
    assert description["settle"] == 0.05
    late = run.error[run.t >= 0.05]
    rms = np.sqrt(np.mean(late**2, axis=0))
    np.testing.assert_allclose(description["metrics"]["rms_error"], rms, rtol=1e-12)
    rows = {line.split()[0]: line.split()[1:3] for line in out.splitlines() if " [m" in line}
    for name, unit, size in (("s1", "[mm]", rms[0]), ("theta1", "[mrad]", rms[3])):
        assert rows[name] == [unit, f"{1e3 * size:.3g}"]
    assert main(["verify", "a"]) == 0


def test_a_run_that_is_too_short_says_so_once_and_what_to_do(capsys: pytest.CaptureFixture[str]):
    assert main(["run", "--duration", "0.1", "--out", "a"]) == 0
    out, err = capsys.readouterr()
    (line,) = [line for line in out.splitlines() if line.startswith("note: ")]
    assert err == ""
    assert "count from 2 s on, and 0.1 s is too short" in line
    assert "--settle 0.02 lets them begin earlier" in line
    assert "rms" not in out
    assert "settle" not in json.loads(Path("a/run.json").read_text())  # it is the usual one
    assert unsettled(2.5, 2.0) == ""


def test_a_sweep_has_it_in_its_spec(capsys: pytest.CaptureFixture[str]):
    text = 'duration = 0.1\n{}[grid]\ncontroller = ["pd", "smc-boundary"]\n'
    Path("short.toml").write_text(text.format(""))
    Path("spec.toml").write_text(text.format('settle = "20ms"\n'))
    spec = parse_spec(Path("spec.toml").read_text())
    assert spec.settle == 0.02 and parse_spec(spec.to_toml()) == spec
    assert spec.hash() != parse_spec(Path("short.toml").read_text()).hash()
    assert main(["sweep", "short.toml", "--out", "short", "--workers", "1"]) == 0
    assert capsys.readouterr().out.count("settle = 0.02 lets them begin earlier") == 1
    assert main(["report", "short", "--metric", "rms_error"]) == 2
    assert "count from 2 s on" in capsys.readouterr().err
    assert main(["sweep", "spec.toml", "--out", "sweep", "--workers", "1"]) == 0
    assert "lets them begin" not in capsys.readouterr().out
    alone = octarm.rollout(
        octarm.load("sine", seed=0), make_controller("pd", octarm.nominal_parameters()), 0.1
    )
    rms = np.sqrt(np.mean(alone.error[alone.t >= 0.02] ** 2, axis=0))
    table = octarm.read_sweep("sweep", ["rms_error_theta1"])
    assert table["rms_error_theta1"][0].as_py() == pytest.approx(rms[3], rel=1e-12)
    assert main(["verify", "sweep", "--episode", "1"]) == 0
    assert main(["report", "sweep", "--metric", "rms_error"]) == 0
    assert "The steady regime begins at 0.02 s" in Path("sweep/report/report.html").read_text()


def test_a_batch_is_measured_from_there_on():
    controller = make_controller("pd", octarm.nominal_parameters())
    early, late = (
        measure(octarm.load("sine", batch=2), controller, 0.05, settle=settle).metrics
        for settle in (0.0, 0.1)
    )
    assert np.all(early["rms_error_theta1"] > 0.0)
    assert np.isnan(late["rms_error_theta1"]).all()


@pytest.mark.parametrize("word", ["-1", "nan", "inf"])
def test_what_is_no_time_is_refused(word: str, capsys: pytest.CaptureFixture[str]):
    assert main(["run", f"--settle={word}", "--out", "a"]) == 2
    bound = "at most 1e+09 s" if word == "inf" else "at least 0 s"
    assert f"settle is {word} s; it must be {bound}" in capsys.readouterr().err

"""What `octarm new` writes runs as it is, and takes the place of nothing."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import test_controller_contract as contract

import octarm
from octarm.commands import cli
from octarm.commands.kinds import NEW_FILES
from octarm.sweeps.spec_file import read_spec


@pytest.fixture(autouse=True)
def _elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("kind", NEW_FILES)
def test_a_file_is_commented_short_and_never_written_over(kind: str, capsys):
    assert cli.main(["new", kind, "My-law_2b"]) == 0
    (file,) = Path().iterdir()
    assert file.name == ("my-law-2b.toml" if kind in ("arm", "experiment") else "my_law_2b.py")
    assert f"wrote {file.name}" in capsys.readouterr().out
    text = file.read_text()
    assert "{{" not in text and text.count("#") >= (1 if kind == "metric" else 2)
    assert len(text.splitlines()) <= 45
    file.write_text("mine")
    assert cli.main(["new", kind, "My-law_2b"]) == 2
    assert f"{file.name} exists; choose another name" in capsys.readouterr().err
    assert file.read_text() == "mine"


@pytest.mark.parametrize(
    ("kind", "option"),
    [
        ("controller", ["--controller", "./soft_wall.py:SoftWall"]),
        ("reference", ["--reference", "./soft_wall.py:SoftWall"]),
        ("disturbance", ["--disturbance", "./soft_wall.py:SoftWall:5"]),
        ("metric", ["--metric", "./soft_wall.py:SoftWall"]),
    ],
)
def test_a_file_runs_as_it_is(kind: str, option: list[str], capsys):
    assert cli.main(["new", kind, "soft-wall"]) == 0
    assert f"try it: octarm run {' '.join(option)}" in capsys.readouterr().out
    assert cli.main(["run", *option, "--duration", "0.05", "--out", "run"]) == 0
    written = json.loads(Path("run/run.json").read_text())
    assert [code["kind"] for code in written["code"].values()] == [kind]
    assert cli.main(["verify", "run"]) == 0


def test_the_controller_keeps_the_contract_and_tracks(tmp_path: Path):
    assert cli.main(["new", "controller", "my-law"]) == 0
    word = f"{tmp_path}/my_law.py:MyLaw"
    contract.test_an_arm_gets_the_same_bits_alone_and_in_any_batch(word, {})
    contract.test_gains_broadcast_along_the_batch(word, {})
    contract.test_no_two_things_share_memory(word, {}, (3,))
    controller = contract.make_controller(word, contract.P)
    run = octarm.rollout(octarm.load(), controller, 2.0)
    rms = np.sqrt(np.mean(run.error[run.t > 1.0, 3:5] ** 2, axis=0))
    assert np.all(rms < 0.02 * contract.AMPLITUDE)
    assert [knob.name for knob in controller.knobs()] == ["K_p", "K_d"]


def test_the_motion_has_exact_derivatives(tmp_path: Path):
    assert cli.main(["new", "reference", "mine"]) == 0
    motion = octarm.references.named_reference(f"{tmp_path}/mine.py:Mine", np.zeros(6))
    h = 1e-4
    for t in (0.0, 0.3, 1.7):
        before, now, after = (motion(t + d) for d in (-h, 0.0, h))
        np.testing.assert_allclose((after.q - before.q) / (2 * h), now.v, atol=1e-6)
        np.testing.assert_allclose((after.v - before.v) / (2 * h), now.a, atol=1e-5)


def test_the_arm_is_one_that_hangs_and_is_controlled(capsys):
    assert cli.main(["new", "arm", "mine"]) == 0
    assert "try it: octarm run --arm mine.toml" in capsys.readouterr().out
    arm = octarm.read_arm("mine.toml")
    np.testing.assert_allclose(arm.mass, [0.3, 0.25, 0.2])
    assert cli.main(["arm", "mine.toml"]) == 0
    assert cli.main(["run", "--arm", "mine.toml", "--duration", "2.1", "--out", "run"]) == 0
    rms = json.loads(Path("run/run.json").read_text())["metrics"]["rms_error"]
    assert max(rms[3:]) < 0.02 * 0.25


def test_the_experiment_is_a_spec_that_can_be_swept(capsys):
    assert cli.main(["new", "experiment", "first"]) == 0
    assert read_spec("first.toml").episodes == 4
    text = Path("first.toml").read_text().replace("duration = 4.0", "duration = 0.01")
    Path("first.toml").write_text(text.replace("payload.at = 1.0", "payload.at = 0.0"))
    assert cli.main(["sweep", "first.toml", "--dry-run"]) == 0
    assert "32 episodes of 0.01 s" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("thing x", "unknown kind 'thing'; known are controller, "),
        ("controllr x", "unknown kind 'controllr', did you mean 'controller'?"),
        ("controller 3x", "name is '3x'; it must be letters and digits, joined by - or _"),
        ("controller ../x", "name is '../x'; it must be"),
        ("disturbance noise", "noise cannot be the name of a disturbance: it is built in"),
        ("disturbance gust-2", "gust-2 cannot be the name of a disturbance"),
    ],
)
def test_names_that_cannot_be_are_refused(words: str, sentence: str, capsys):
    assert cli.main(["new", *words.split()]) == 2
    assert sentence in capsys.readouterr().err
    assert os.listdir() == []

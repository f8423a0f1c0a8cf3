"""What the README says works."""

import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from own_things import write_things

import octarm
from controllers import CONTROLLERS, make_controller
from octarm.commands.app import commands, parse
from octarm.commands.cli import main
from octarm.disturbances.spelling import DISTURBANCES, parse_disturbance
from octarm.references import REFERENCES
from octarm.sweeps.spec_file import read_spec

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "README.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```(\w*)\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)
PYTHON = [code for language, code in BLOCKS if language == "python"]
SHELL = [
    line
    for language, code in BLOCKS
    if language in ("", "text", "sh")
    for line in code.splitlines()
    if "octarm " in line
]
SPOKEN = [code for code in re.findall(r"`(octarm [^`]*)`", TEXT) if "COMMAND" not in code]


@pytest.mark.parametrize("code", PYTHON, ids=lambda code: code.partition("\n")[0][:40])
def test_every_python_block_runs(code: str):
    exec(compile(code, "README.md", "exec"), {"__name__": "readme"})


def test_the_example_has_eight_lines():
    assert len(PYTHON[0].strip().splitlines()) == 8


@pytest.mark.parametrize("line", [*SHELL, *SPOKEN])
def test_every_command_is_understood(line: str):
    words = shlex.split(line[line.index("octarm ") :].partition(">>")[0], comments=True)
    words = [word.strip("[]") for word in words if word != ".."]
    assert words[1] in commands()
    assert callable(parse(words[1:]))


def test_the_two_commands_are_the_only_ones_of_sh():
    first, second = [line for lang, code in BLOCKS if lang == "sh" for line in code.splitlines()]
    assert first.endswith("octarm run --view") and second.endswith("pytest -n auto")


def test_every_command_controller_and_reference_that_stands_there_is_known():
    table = TEXT.partition("## What it does")[2].partition("\n\n`octarm COMMAND")[0]
    assert set(re.findall(r"`octarm (\w+)", table)) == set(commands())
    named = re.search(r"^Controllers: (.*?)\. A run", TEXT, re.MULTILINE)
    assert named is not None
    assert set(re.findall(r"`([\w-]+)`", named[1])) == set(CONTROLLERS)
    assert set(re.findall(r'octarm\.load\("([\w-]+)"', TEXT)) <= set(REFERENCES)


def test_every_file_that_it_names_is_there():
    linked = re.findall(r"\]\(([^)#:]+)\)", TEXT) + re.findall(r'(?:src|href)="([^"]+)"', TEXT)
    named = re.findall(r"`((?:octarm|controllers|models|scripts|tests)/[\w./-]*)`", TEXT)
    assert linked and named
    missing = [name for name in [*linked, *named] if not (ROOT / name).exists()]
    assert not missing


def test_contributing_is_short():
    assert len(TEXT.partition("## Contributing")[2].splitlines()) < 25


def test_what_is_asked_for_is_what_is_written():
    asked = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    table = TEXT.partition("## Versions")[2].partition("## Limits")[0]
    for requirement in re.findall(r"^\| `([^`]+)` \|", table, re.MULTILINE):
        assert f'"{requirement}"' in asked, requirement
    assert 'requires-python = ">=3.11,<3.13"' in asked


@pytest.fixture
def mine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder outside the package with the files of the README, in which commands are run."""
    folder = write_things(tmp_path / "mine")  # of which reach.py is named, too
    for code in PYTHON:
        if file := re.match(r'"""(\w+\.py): ', code):
            (folder / file[1]).write_text(code, encoding="utf-8")
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def wall(mine: Path) -> Any:
    """The README's disturbance."""
    return DISTURBANCES[f"{mine}/wall.py:Wall"]


def test_what_is_your_own_runs_as_it_stands(mine: Path):
    lines = [line for line in SPOKEN if "octarm run" in line and ".py:" in line]
    assert len(lines) == 2
    for i, line in enumerate(lines):
        assert main([*shlex.split(line)[1:], "--duration", "0.05", "--out", f"{i}"]) == 0
        assert main(["verify", f"{i}"]) == 0
    for line in (line for line in SPOKEN if line.startswith("octarm new")):
        if "KIND" not in line:
            assert main(shlex.split(line)[1:]) == 0
    (spec,) = (code for _, code in BLOCKS if code.startswith("metric = "))
    (mine / "spec.toml").write_text(f"duration = 2.1\n{spec}", encoding="utf-8")
    assert read_spec(mine / "spec.toml").controllers == ("Feedforward", "smc-boundary")
    assert main(["sweep", "spec.toml", "--out", "sweep", "--workers", "1"]) == 0


def test_the_disturbance_in_the_readme_holds_the_arm_back(wall: type):
    controller = make_controller("pd", octarm.nominal_parameters())
    free = octarm.rollout(octarm.load("sine"), controller, 1.0)
    held = octarm.rollout(octarm.load("sine", disturbances=[wall(stiffness=5.0)]), controller, 1.0)
    beyond = held.q[:, 3] > 0.2
    np.testing.assert_array_equal(held.disturbance[held.q[:, 3] < 0.199], 0.0)  # a step ahead
    expected = -5.0 * (held.q[beyond, 3] - 0.2)
    np.testing.assert_allclose(held.disturbance[beyond, 3], expected, rtol=0.0, atol=0.02)
    assert held.q[:, 3].max() < free.q[:, 3].max() - 1e-3


def test_the_disturbance_in_the_readme_is_spelt_and_the_same_in_a_batch(wall: type):
    spelt = parse_disturbance("./wall.py:Wall:5,angle=0.1")
    assert isinstance(spelt, wall)
    alone = octarm.load("sine", disturbances=[spelt])
    many = octarm.load("sine", disturbances=[spelt], batch=3)
    for environment in (alone, many):
        environment.reset()
    for _ in range(100):
        force = np.tile([30.0, -30.0], 3)
        alone.step(force)
        many.step(np.tile(force, (3, 1)))
    assert alone.physics.q()[3] > 0.1
    np.testing.assert_array_equal(many.physics.q()[1], alone.physics.q())


def test_the_module_runs_as_the_command():
    done = subprocess.run(
        [sys.executable, "-m", "octarm", "--version"],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    assert done.stdout.startswith("octarm ")

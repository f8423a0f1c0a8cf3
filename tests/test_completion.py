"""Shells complete what the commands know."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from controllers import CONTROLLERS
from octarm.commands import cli
from octarm.commands.app import arguments_of, commands, is_operand
from octarm.commands.kinds import SHELLS

BIN = Path(sys.executable).parent  # where the installed command is


def script(shell: str, capsys: pytest.CaptureFixture[str]) -> str:
    assert cli.main(["completion", shell]) == 0
    return capsys.readouterr().out


@pytest.mark.parametrize("shell", SHELLS)
def test_a_script_is_well_formed_and_has_all_commands_and_options(
    shell: str, capsys: pytest.CaptureFixture[str]
):
    text = script(shell, capsys)
    for name in commands():
        assert name in text
        for argument in arguments_of(name):
            if not is_operand(argument):
                assert argument.name.removeprefix("--") in text
    if shutil.which(shell):
        subprocess.run([shell, "-n"], input=text, text=True, check=True, capture_output=True)


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is what is tested")
def test_bash_offers_what_fits(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    (tmp_path / "runs" / "mine").mkdir(parents=True)
    (tmp_path / "gains.toml").touch()
    lines = {
        "": set(commands()),
        "comp": {"compare", "completion"},
        "run --contr": {"--controller", "--control-period"},
        "run --controller afsmc": {"afsmc", "afsmc-consequent"},
        "run --duration ": set(),
        "run --duration 3 --see": {"--seed"},
        "run --out r": {"runs"},
        "run --gains ": {"tuned", "recommended", "gains.toml"},
        "replay runs/": {"runs/mine"},
        "replay runs --w": {"--web"},
        "tune ": set(CONTROLLERS),
        "completion ": {"bash", "zsh", "fish"},
        "margin pd sm": {"smc", "smc-boundary", "smc-integral"},
    }
    quotes = "''"
    asked = "".join(
        f"COMP_WORDS=(octarm {line}{quotes if line[-1:] in ' ' else ''})\n"
        "COMP_CWORD=$((${#COMP_WORDS[@]} - 1))\n"
        '_octarm octarm "${COMP_WORDS[COMP_CWORD]}" "${COMP_WORDS[COMP_CWORD-1]}"\n'
        "printf '%s\\n' \"${COMPREPLY[@]}\" ; echo ==\n"
        for line in lines
    )
    done = subprocess.run(
        ["bash", "--norc"], input=script("bash", capsys) + asked, text=True, capture_output=True,
        cwd=tmp_path, check=True, env={**os.environ, "PATH": f"{BIN}:{os.environ['PATH']}"},
    )  # fmt: skip
    assert done.stderr == ""
    answers = done.stdout.split("==\n")
    for (line, wanted), answer in zip(lines.items(), answers, strict=False):
        assert set(answer.splitlines()) - {""} == wanted, line

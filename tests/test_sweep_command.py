"""The command: what it prints, and what it says of bad input."""

from pathlib import Path

import dask.config
import distributed  # noqa: F401  its defaults must be there before one of them is changed
import pytest
from test_sweep import SPEC

import octarm
from octarm.commands.cli import main
from octarm.errors import ExitCode


@pytest.fixture
def spec_file(tmp_path) -> Path:
    file = tmp_path / "my.toml"
    file.write_text(SPEC)
    return file


def test_the_command_writes_a_sweep_and_prints_a_row_a_controller(tmp_path, spec_file, capsys):
    arguments = ["sweep", str(spec_file), "--out", str(tmp_path / "s"), "--workers", "1"]
    assert main(arguments) == ExitCode.FINE
    out = capsys.readouterr().out
    assert "smc-boundary                12         0" in out
    assert "pd                          12         0" in out
    assert str(tmp_path / "s") in out
    assert main(arguments) == ExitCode.BAD_INPUT
    assert "go on with it by --resume, replace it by --force" in capsys.readouterr().err
    table = octarm.read_sweep(tmp_path / "s").drop_columns(["wall_time"])
    spec_file.write_text(SPEC.replace("seed = ", "seed = 1"))
    assert main([*arguments, "--resume"]) == ExitCode.BAD_INPUT
    assert main([*arguments, "--force"]) == ExitCode.FINE
    assert not octarm.read_sweep(tmp_path / "s").drop_columns(["wall_time"]).equals(table)
    assert main(["verify", str(tmp_path / "s"), "--episode", "3"]) == ExitCode.FINE


def test_a_dry_run_says_what_it_will_take(spec_file, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    assert main(["sweep", str(spec_file), "--dry-run", "--workers", "2"]) == ExitCode.FINE
    out = capsys.readouterr().out
    assert "24 episodes of 0.02 s in 6 shards" in out
    assert "mismatch: -0.3, 0.3" in out
    assert "on 2 workers" in out
    assert [file.name for file in tmp_path.iterdir()] == ["my.toml"]


@pytest.mark.parametrize(
    ("old", "new", "options", "told"),
    [
        ("", "", [], "there is no folder to write to; give --out DIR, or --dry-run"),
        ("", "", ["--out", "s", "--workers", "0"], "workers is 0"),
        ("pd", "dp", ["--out", "s"], "my.toml, line 6: unknown controller 'dp'; known are pd,"),
        ("[grid]", "[gains.pd]\nK_q=9\n[grid]", ["--dry-run"], "my.toml, line 5: pd has no gain"),
        ("seed", "sede", ["--out", "s"], "my.toml, line 1: unknown key 'sede'"),
        ("", "", ["--out", "s", "--cluster", "tcp://127.0.0.1:1"], "no dask scheduler answers"),
        ("", "", ["--out", "my.toml"], "my.toml is not a folder"),
        ("", "", ["--out", "s", "--resume"], "there is nothing in s to go on with by --resume"),
        ("", "", ["--out", "s", "--resume", "--force"], "--resume and --force exclude each other"),
    ],
)
def test_bad_input_is_one_sentence(spec_file, capsys, monkeypatch, old, new, options, told):
    monkeypatch.chdir(spec_file.parent)
    spec_file.write_text(SPEC.replace(old, new) if old else SPEC)
    with dask.config.set({"distributed.comm.timeouts.connect": "0.2s"}):
        assert main(["sweep", "my.toml", *options]) == ExitCode.BAD_INPUT
    error = capsys.readouterr().err
    assert told in error
    assert error.count("\n") == 1
    assert not (spec_file.parent / "s").exists()

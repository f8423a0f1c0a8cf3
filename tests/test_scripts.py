"""The worked experiments run as they are."""

import json
import subprocess
import sys
from pathlib import Path

from controllers import CONTROLLERS

SCRIPTS = Path(__file__).resolve().parent.parent / "scripts"


def test_compare_controllers_prints_its_table(tmp_path):
    done = subprocess.run(
        [sys.executable, SCRIPTS / "compare_controllers.py", "--duration", "2.05",
         "--disturbance", "noise:0.4"],
        cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    title, *rows = done.stdout.splitlines()
    assert "-30 %" in title and "+30 %" in title
    assert [row.split()[0] for row in rows] == list(CONTROLLERS)
    assert all(0.0 < float(number) < 0.1 for row in rows for number in row.split()[1:])


def test_the_benchmark_prints_its_figures(tmp_path):
    done = subprocess.run(
        [sys.executable, SCRIPTS / "benchmark.py", "--arms", "8", "--seconds", "0.02",
         "--json", "figures.json"],
        cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    figures = json.loads((tmp_path / "figures.json").read_text(encoding="utf-8"))
    assert "afsmc" in done.stdout
    assert figures

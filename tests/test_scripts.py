"""The worked experiments run as they are."""

import subprocess
import sys
from pathlib import Path

SCRIPTS = Path(__file__).resolve().parent.parent / "scripts"


def test_compare_controllers_prints_its_table(tmp_path):
    done = subprocess.run(
        [sys.executable, SCRIPTS / "compare_controllers.py", "--duration", "2.05"],
        cwd=tmp_path, capture_output=True, text=True, timeout=300, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    title, *rows = done.stdout.splitlines()
    assert "-30 %" in title and "+30 %" in title
    assert [row.split()[0] for row in rows] == ["computed-torque", "smc", "smc-boundary"]
    assert all(0.0 < float(number) < 0.1 for row in rows for number in row.split()[1:])

"""The worked sweep runs as it is."""

import subprocess
import sys
from pathlib import Path

import pytest

import octarm
from controllers import CONTROLLERS

SCRIPT = Path(__file__).resolve().parent.parent / "scripts" / "disturbance_sweep.py"


@pytest.mark.slow
def test_the_quick_sweep_prints_its_tables(tmp_path):
    done = subprocess.run(
        [sys.executable, SCRIPT, "--quick", "--out", "sweep"],
        cwd=tmp_path, capture_output=True, text=True, timeout=1800, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    noise, mismatch = done.stdout.strip().split("\n\n")
    for text, values in ((noise, ["+0%", "+20%", "+40%", "+60%", "+80%"]),
                         (mismatch, ["-30%", "+0%", "+30%"])):  # fmt: skip
        _, heading, *rows = text.splitlines()
        assert heading.split() == values
        assert [row.split()[0] for row in rows] == list(CONTROLLERS)
    # Noise costs whoever follows its model; what is printed is the median of the table.
    table = octarm.read_sweep(tmp_path / "sweep", ["controller", "noise", "tip_rms_error"])
    errors = sorted(
        1e3 * row["tip_rms_error"]
        for row in table.to_pylist()
        if row["controller"] == "computed-torque" and row["noise"] == 0.8
    )
    row = next(row for row in noise.splitlines() if row.split()[:1] == ["computed-torque"])
    assert row.split()[-1] == f"{0.5 * (errors[2] + errors[3]):.3g}"


def test_the_spec_is_the_one_that_is_described():
    spec = octarm.read_spec(SCRIPT.with_suffix(".toml"))
    axes = {axis.name: axis.values for axis in spec.axes}
    assert axes["controller"] == tuple(CONTROLLERS)
    assert min(axes["noise"]) == 0.0 and max(axes["noise"]) == 0.8
    assert axes["mismatch"] == (-0.3, 0.0, 0.3)
    assert spec.episodes == 64

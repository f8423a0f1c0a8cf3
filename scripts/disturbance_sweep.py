"""Runs disturbance_sweep.toml, and prints how the tip's error grows with noise and model error.

Run it: python scripts/disturbance_sweep.py [--quick] [--out DIR]
Run it again with the same options, and it goes on where it was interrupted.
"""

import argparse
import dataclasses
from pathlib import Path

import numpy as np

import octarm
from controllers import make_controller
from octarm.sweeps.progress import ProgressBar

SPEC = Path(__file__).with_suffix(".toml")
METRIC = "tip_rms_error"
QUICK = {"episodes": 2, "duration": 1.0, "settle": 0.6, "timestep": 0.001, "control_period": 0.001}


def run(out: Path, **changes: float) -> dict[str, np.ndarray]:
    """The columns of the sweep's table, of the spec with some fields changed."""
    spec = dataclasses.replace(octarm.read_spec(SPEC), **changes)
    with ProgressBar(spec) as bar:
        octarm.sweep(spec, make_controller, out, resume=True, progress=bar.update, say=bar.say)
    table = octarm.read_sweep(out, ["controller", "noise", "mismatch", "status", METRIC])
    return {name: np.array(table[name].to_pylist()) for name in table.column_names}


def show(columns: dict[str, np.ndarray], axis: str) -> None:
    """Prints a row a controller, a column a value: median error [mm], share of diverged runs."""
    values = np.unique(columns[axis])
    print(f"\ntip error, rms [mm], median over all seeds; (share diverged) by {axis}")
    print(f"{'':>18}", *(f"{value:+.0%}".rjust(15) for value in values))
    for name in dict.fromkeys(columns["controller"].tolist()):
        own = columns["controller"] == name
        print(f"{name:>18}", *(cell(columns, own & (columns[axis] == value)) for value in values))


def cell(columns: dict[str, np.ndarray], which: np.ndarray) -> str:
    """Those that diverged count as worse than all others."""
    diverged = columns["status"][which] == "diverged"
    error = np.where(diverged, np.inf, columns[METRIC][which].astype(float))
    share = f"({diverged.mean():.0%})" if diverged.any() else ""
    return f"{1e3 * np.median(error):8.3g} {share:>6}"


def main() -> None:
    """Runs the sweep, or goes on with it."""
    parser = argparse.ArgumentParser(description="Runs the sweep, or goes on with it.")
    parser.add_argument("--out", type=Path, help="folder of the sweep, below runs/ when not given")
    parser.add_argument("--quick", action="store_true", help="2 seeds and 1 s at 1 kHz: a glance")
    options = parser.parse_args()
    folder = Path("runs/disturbance-sweep-quick" if options.quick else "runs/disturbance-sweep")
    columns = run(options.out or folder, **(QUICK if options.quick else {}))
    show(columns, "noise")
    show(columns, "mismatch")


if __name__ == "__main__":  # the worker processes import this file, too
    main()

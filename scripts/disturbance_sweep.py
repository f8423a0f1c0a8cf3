"""Runs disturbance_sweep.toml, and prints how the error of theta1 grows with the noise.

Run it: python scripts/disturbance_sweep.py [--episodes 4 --duration 4] [--out DIR]
Run it again with the same options, and it goes on where it was interrupted.
"""

import argparse
import dataclasses
from pathlib import Path

import numpy as np
import pyarrow as pa
from tqdm import tqdm

import octarm
from controllers import make_controller

SPEC = Path(__file__).with_suffix(".toml")


def run(out: Path, **changes: float) -> pa.Table:
    """A row an episode, of the spec with some fields changed."""
    spec = dataclasses.replace(octarm.read_spec(SPEC), **changes)
    with tqdm(unit=" episodes", disable=None) as bar:
        octarm.sweep(spec, make_controller, out, resume=True, progress=bar.update, say=print)
    return octarm.read_sweep(out, ["controller", "noise", "status", "rms_error_theta1"])


def show(table: pa.Table) -> None:
    """Prints a row a controller, a column a noise: median error [rad], share of diverged runs."""
    columns = {name: np.array(table[name].to_pylist()) for name in table.column_names}
    error = columns["rms_error_theta1"].astype(float)  # NaN where there is none
    diverged = columns["status"] == "diverged"
    noises = np.unique(columns["noise"])
    print("rms error of theta1 [rad], median (share diverged)")
    print(" " * 18, *(f"noise {noise:.0%}".rjust(15) for noise in noises))
    for name in dict.fromkeys(columns["controller"].tolist()):
        cells = [(columns["controller"] == name) & (columns["noise"] == noise) for noise in noises]
        print(f"{name:>18}", *(f"{_median(error[c])} ({diverged[c].mean():4.0%})" for c in cells))


def _median(errors: np.ndarray) -> str:
    known = errors[np.isfinite(errors)]
    return f"{np.median(known):8.1e}" if known.size else "-".rjust(8)


def main() -> None:
    """Runs the sweep, or goes on with it."""
    parser = argparse.ArgumentParser(description=__doc__)
    folder = Path("runs/disturbance-sweep")
    parser.add_argument("--out", type=Path, default=folder, help="its folder")
    parser.add_argument("--episodes", type=int, default=64, help="seeds in each cell")
    parser.add_argument("--duration", type=float, default=10.0, help="length of an episode [s]")
    options = parser.parse_args()
    show(run(options.out, episodes=options.episodes, duration=options.duration))


if __name__ == "__main__":  # the worker processes import this file, too
    main()

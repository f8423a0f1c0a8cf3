"""An arm of five modules instead of three: its modes, two controllers on it, and its shapes.

Nothing knows the number of modules but the parameters; gains for an arm that is not the nominal one
come from its mass matrix.
Run it: python scripts/five_modules.py [--modules 5] [--duration 6] [--out FILE.png]
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import octarm
from controllers import make_controller
from octarm.arm.kinematics import positions
from octarm.arm.lagrange import equilibrium
from octarm.arrays import coordinate_names
from octarm.checks.free_motion import undamped_frequencies
from octarm.checks.validation import arm_with
from octarm.references import Sine

PERIOD = 2.0  # of the wave [s]


def wave(arm: octarm.ArmParameters) -> Sine:
    """A wave that runs along the arm: every module stretches and bends, one after the other."""
    n = arm.modules
    lag = np.tile(np.arange(n) * 2.0 * np.pi / n, 2)  # [rad]
    amplitude = np.repeat([0.01, 2.0 / n], n)  # [m], [rad]
    return Sine(center=equilibrium(arm), amplitude=amplitude, frequency=1.0 / PERIOD, phase=-lag)


def draw(runs: dict[str, octarm.Trajectory], file: Path) -> None:
    """The arm at six instants of the last period, the desired shape as a broad line."""
    figure = Figure(figsize=(6, 5), layout="constrained")
    axes = figure.subplots(1, len(runs), sharex=True, sharey=True)
    for axis, (name, run) in zip(axes, runs.items(), strict=True):
        rows = np.linspace(np.searchsorted(run.t, run.t[-1] - PERIOD), len(run) - 1, 7)[1:]
        for i, k in enumerate(rows.astype(int)):
            color = f"C{i}"
            for q, style in ((run.q_d[k], {"lw": 7, "alpha": 0.25}), (run.q[k], {"marker": "."})):
                x, y = np.concatenate([np.zeros((1, 2)), positions(q)]).T
                axis.plot(y, -x, color=color, **style)
        axis.set(title=name, xlabel="across [m]", aspect="equal")
    axes[0].set_ylabel("height [m]")
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=150)


def main() -> None:
    """Prints the arm's modes and the errors of each coordinate, and draws the arm in motion."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--modules", type=int, default=5, help="their number")
    parser.add_argument("--duration", type=float, default=6.0, help="length of each run [s]")
    parser.add_argument("--out", type=Path, default=Path("runs/five-modules.png"), help="figure")
    options = parser.parse_args()
    arm = arm_with(options.modules)
    print("lengths at rest [m]:", *(f"{s:.4f}" for s in equilibrium(arm)[: arm.modules]))
    print("modes [Hz]:", *(f"{f:.1f}" for f in undamped_frequencies(arm)))
    print("rms error, model wrong by -30 %  ", *(f"{c:>8}" for c in coordinate_names(arm.modules)))
    runs: dict[str, octarm.Trajectory] = {}
    for name in ("smc-boundary", "afsmc"):
        controller = make_controller(name, arm.mismatched(-0.3))
        environment = octarm.load(wave(arm), parameters=arm)
        runs[name] = run = octarm.rollout(environment, controller, options.duration)
        late = run.error[run.t >= 0.5 * options.duration]
        print(f"{name:>33}", *(f"{e:8.1e}" for e in np.sqrt(np.mean(late**2, axis=0))), run.message)
    draw(runs, options.out)
    print(f"wrote {options.out}")


if __name__ == "__main__":
    main()

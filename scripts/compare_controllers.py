"""Compares two controllers on the default sine, for nominal models that are more and less wrong.

Each controller drives one batch of arms, which differ in the model that the controller believes.
All arms meet the same disturbance. Prints a table and draws the error of theta1 over time.
Run it: python scripts/compare_controllers.py [A B] [--disturbance noise:0.4] [--duration 6]
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import octarm
from controllers import CONTROLLERS, make_controller
from octarm.disturbances.episode import Disturbance
from octarm.disturbances.spelling import parse_disturbance
from octarm.simulation.rollout import simulate

MISMATCHES = np.array([-0.3, 0.0, 0.3])  # of masses, inertias and damping; half of stiffness
BEGIN = 1.0  # errors count from here on, when the start from rest is over [s]


def errors(name: str, disturbances: list[Disturbance], duration: float) -> np.ndarray:
    """Error of theta1 of each arm at each control instant, shape (T, arms) [rad]."""
    arm, arms = octarm.nominal_parameters(), len(MISMATCHES)
    same = [np.random.SeedSequence(0)] * arms  # one realisation of the disturbance for all
    environment = octarm.load("sine", disturbances=disturbances, batch=arms, seed=same)
    controller = make_controller(name, arm.mismatched(MISMATCHES))
    rows: list[np.ndarray] = []
    theta1 = arm.modules
    simulate(environment, controller, duration, lambda now: rows.append(now.q - now.reference.q))
    out = np.stack(rows)[:, :, theta1]
    out[:, ~environment.physics.intact()] = np.nan  # an arm that diverged has no error
    return out


def draw(errors_by_name: dict[str, np.ndarray], duration: float, file: Path) -> None:
    """The error of theta1 over time, a column a mismatch."""
    figure = Figure(figsize=(9, 3), layout="constrained")
    axes = figure.subplots(1, len(MISMATCHES), sharey=True)
    for i, (axis, mismatch) in enumerate(zip(axes, MISMATCHES, strict=True)):
        for name, error in errors_by_name.items():
            t = np.linspace(0.0, duration, len(error))
            axis.plot(t, 1e3 * error[:, i], label=name, linewidth=0.8)
        axis.set(title=f"model wrong by {mismatch:.0%}", xlabel="time [s]")
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("error of theta1 [mrad]")
    axes[1].legend(fontsize="small", loc="lower center", ncols=2)
    file.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(file, dpi=150)


def main() -> None:
    """Prints a row a mismatch, a column a controller."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=["smc-boundary", "afsmc"], metavar="NAME")
    parser.add_argument("--disturbance", action="append", help="NAME:VALUE; noise:0.4 if not given")
    parser.add_argument("--duration", type=float, default=6.0, help="length of each run [s]")
    parser.add_argument("--out", type=Path, default=Path("runs/compare.png"), help="the figure")
    options = parser.parse_args()
    if not options.duration > BEGIN:
        parser.error(f"duration is {options.duration:g} s; it must be above {BEGIN:g} s")
    if len(options.names) != 2 or not set(options.names) <= set(CONTROLLERS):
        parser.error(f"two controllers are compared; known are {', '.join(CONTROLLERS)}")
    listed = [parse_disturbance(text) for text in options.disturbance or ["noise:0.4"]]
    found = {name: errors(name, listed, options.duration) for name in options.names}
    print("rms error of theta1 [rad]")
    print("model wrong by", *(name.rjust(16) for name in found))
    for i, mismatch in enumerate(MISMATCHES):
        settled = [e[int(BEGIN / options.duration * len(e)) :, i] for e in found.values()]
        print(f"{mismatch:14.0%}", *(f"{np.sqrt(np.mean(e * e)):16.2e}" for e in settled))
    draw(found, options.duration, options.out)
    print(f"wrote {options.out}")


if __name__ == "__main__":
    main()

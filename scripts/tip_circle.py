"""Follows a circle with the tip: a path in the plane becomes a desired motion of the joints.

Of all shapes with the tip at its place the one is taken that the springs resist least, with the
smallest 1/2 (q - rest)^T K (q - rest): a function of the place alone, so that a closed path of the
tip is a closed path of the joints. A spline through them gives velocities and accelerations.
Run it: python scripts/tip_circle.py [--radius 0.04] [--duration 6] [--out FILE.png]
"""

import argparse
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import octarm
from controllers import make_controller
from octarm.arm.kinematics import jacobian, positions
from octarm.arm.lagrange import equilibrium, stiffness_matrix
from octarm.references import Spline

PERIOD = 3.0  # of a round [s]


def circle(center: np.ndarray, radius: float, t: np.ndarray) -> np.ndarray:
    """A point on a circle at times t, shape (T,) [s] to (T, 2) [m]; within 1 s from its centre."""
    x = np.clip(t, 0.0, 1.0)
    reach = radius * x**3 * (10.0 - 15.0 * x + 6.0 * x**2)  # minimum jerk
    angle = 2.0 * np.pi * t / PERIOD
    return center + reach[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def shapes(arm: octarm.ArmParameters, tips: np.ndarray) -> np.ndarray:
    """Coordinates with the tip at these points, shape (T, 2) [m], to (T, 2N) [m], [rad]."""
    rest, flexibility = equilibrium(arm), np.linalg.inv(stiffness_matrix(arm))
    q = np.tile(rest, (len(tips), 1))
    for _ in range(50):  # each step with the tip's place taken as linear, all points at once
        J = jacobian(q)[:, -1]
        missing = tips - positions(q)[:, -1] + np.einsum("tij,tj->ti", J, q - rest)
        way = flexibility @ np.swapaxes(J, 1, 2)
        before, q = q, rest + (way @ np.linalg.solve(J @ way, missing[..., None]))[..., 0]
        if np.max(np.abs(q - before)) < 1e-11:
            return q
    raise SystemExit("the circle is out of reach; choose a smaller radius")


def main() -> None:
    """Follows the circle with two controllers, prints how far off the tip is, and draws it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--radius", type=float, default=0.04, help="of the circle [m]")
    parser.add_argument("--duration", type=float, default=6.0, help="length of each run [s]")
    parser.add_argument("--out", type=Path, default=Path("runs/tip-circle.png"), help="figure")
    options = parser.parse_args()
    arm = octarm.nominal_parameters()
    t = np.linspace(0.0, options.duration, 1 + int(50.0 * options.duration))
    tips = circle(positions(equilibrium(arm))[-1], options.radius, t)
    motion = Spline(times=t, points=shapes(arm, tips))
    figure = Figure(figsize=(5, 5), layout="constrained")
    axis = figure.subplots()
    axis.plot(tips[:, 1], -tips[:, 0], color="black", lw=6, alpha=0.2, label="wanted")
    for name in ("smc-boundary", "afsmc"):
        controller = make_controller(name, arm.mismatched(-0.1))
        run = octarm.rollout(octarm.load(motion), controller, options.duration)
        tip, wanted = positions(run.q)[:, -1], positions(run.q_d)[:, -1]
        off = np.linalg.norm(tip - wanted, axis=-1)[run.t > 0.5 * options.duration]
        mean, most = 1e3 * np.mean(off), 1e3 * np.max(off)
        print(f"{name:>13}: tip off by {mean:.3f} mm, {most:.3f} mm at most", run.message)
        axis.plot(tip[:, 1], -tip[:, 0], label=name, lw=1)
    axis.set(xlabel="across [m]", ylabel="height [m]", aspect="equal")
    figure.legend(loc="outside upper center", ncols=3)
    options.out.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(options.out, dpi=150)
    print(f"wrote {options.out}")


if __name__ == "__main__":
    main()

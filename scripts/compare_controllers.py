"""Compares the controllers on the default sine, with a right and with two wrong nominal models.

The three arms of a controller run as one batch; each believes its own nominal model.
Run it: python scripts/compare_controllers.py [--duration 4] [--disturbance noise:0.4]
"""

import argparse

import numpy as np

import octarm
from controllers import CONTROLLERS, make_controller
from octarm.disturbances import parse_disturbance
from octarm.metrics import SETTLED_AFTER, Block, Metrics
from octarm.rollout import Instant, drive

MISMATCHES = np.array([-0.3, 0.0, 0.3])


def rms_errors(name: str, disturbances: list, duration: float) -> np.ndarray:
    """Error of theta1 [rad], root mean square once the arm has settled; NaN when diverged."""
    arm = octarm.nominal_parameters()
    believed = arm.scaled(
        mass=1.0 + MISMATCHES[:, None],
        inertia=1.0 + MISMATCHES[:, None],
        damping=1.0 + MISMATCHES[:, None, None],
        stiffness=1.0 + MISMATCHES[:, None, None] / 2.0,
    )
    environment = octarm.load("sine", disturbances=disturbances, batch=len(MISMATCHES))
    metrics = Metrics(control_period=environment.control_timestep())

    def observe(instant: Instant) -> None:
        t, force = instant.measurement.t, instant.command.force
        rows = (instant.q, instant.reference.q, instant.tau, force)
        metrics.update(Block(np.array([t]), *(row[None] for row in rows), signals={}))

    drive(environment, make_controller(name, nominal=believed), duration, observe)
    diverged = ~environment.physics.intact()
    return metrics.result(diverged=diverged)["rms_error"][:, arm.modules]


def main() -> None:
    """Prints a table: a row a controller, a column a mismatch of its nominal model."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--duration", type=float, default=4.0, help="length of each run [s]")
    parser.add_argument("--disturbance", action="append", default=[], help="NAME:VALUE")
    options = parser.parse_args()
    if not options.duration > SETTLED_AFTER:
        parser.error(f"duration is {options.duration:g} s; it must be above {SETTLED_AFTER:g} s")
    disturbances = [parse_disturbance(text) for text in options.disturbance]
    print("rms error of theta1 [rad]", *(f"{100 * m:+.0f} %".rjust(10) for m in MISMATCHES))
    for name in CONTROLLERS:
        errors = rms_errors(name, disturbances, options.duration)
        print(f"{name:>25}", *(f"{error:10.1e}" for error in errors))


if __name__ == "__main__":
    main()

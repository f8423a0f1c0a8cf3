"""Compares the controllers on the default sine, with a right and with two wrong nominal models.

Run it: python scripts/compare_controllers.py [--duration 4]
"""

import argparse

import numpy as np

import octarm
from controllers import CONTROLLERS, make_controller
from octarm.metrics import SETTLED_AFTER

MISMATCHES = (-0.3, 0.0, 0.3)


def rms_error(name: str, mismatch: float, duration: float) -> str:
    """Error of theta1 [rad], root mean square once the arm has settled."""
    arm = octarm.nominal_parameters()
    controller = make_controller(name, nominal=arm.mismatched(mismatch))
    run = octarm.rollout(octarm.load("sine"), controller, duration)
    if run.status != "ok":
        return run.status
    theta1 = arm.modules
    error = run.error[run.t >= SETTLED_AFTER, theta1]
    return f"{np.sqrt(np.mean(error**2)):.1e}"


def main() -> None:
    """Prints a table: a row a controller, a column a mismatch of its nominal model."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--duration", type=float, default=4.0, help="length of each run [s]")
    duration = parser.parse_args().duration
    if not duration > SETTLED_AFTER:
        parser.error(f"duration is {duration:g} s; it must be above {SETTLED_AFTER:g} s")
    print("rms error of theta1 [rad]", *(f"{100 * m:+.0f} %".rjust(10) for m in MISMATCHES))
    for name in CONTROLLERS:
        errors = [rms_error(name, mismatch, duration) for mismatch in MISMATCHES]
        print(f"{name:>25}", *(f"{error:>10}" for error in errors))


if __name__ == "__main__":
    main()

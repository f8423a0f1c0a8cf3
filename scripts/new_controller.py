"""Designs a controller from scratch, and tries it on a disturbed arm beside two others.

A sliding mode that does not switch, with an integral w that learns what the model lacks:

    Q = D^ q_r'' + (C^ + B^) q_r' + G^ - K_s s - w,    w' = L s,    s = q' - q_r'

For a constant model error F, V = 1/2 s^T D s + 1/2 sum_j (w_j - F_j)^2 / L_j has
V' = -s^T (B + K_s) s by eqs (32)-(38): s vanishes, and w finds F.
Run it: python scripts/new_controller.py [--duration 6] [--out DIR]
"""

import argparse
import dataclasses
from pathlib import Path

import numpy as np

import octarm
from controllers import make_controller
from controllers.law import elapsed
from controllers.recommended import apparent_mass
from controllers.sliding_mode import SlidingLaw
from octarm.arm.kinematics import positions
from octarm.arm.nominal import LagrangeModel
from octarm.disturbances.spelling import parse_disturbance
from octarm.interfaces import Command, Measurement, Reference
from octarm.recordings.recording import write_recording

DISTURBANCES = ("payload:0.1,at=0.2", "noise:0.1", "measurement-noise:1e-4")
State = tuple[float, np.ndarray]  # time of the last call [s], and w, shape (..., 2N) [N], [N m]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class LearningSlidingMode(SlidingLaw):
    """The law above. The gains broadcast to (..., 2N), so that a batch can hold many of them."""

    K_s: np.ndarray  # [N s/m], [N m s/rad]
    L: np.ndarray  # [N/m], [N m/rad]

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> State:
        """Nothing is learnt yet."""
        return 0.0, np.zeros((*batch_shape, self.nominal.coordinates))

    def __call__(
        self, state: State, measurement: Measurement, reference: Reference
    ) -> tuple[Command, State]:
        """The generalised force at this instant, shape (..., 2N) [N], [N m]."""
        surface = self.surface(measurement, reference)
        w = state[1] + elapsed(state[0], measurement.t) * self.L * surface.s
        switching = -self.K_s * surface.s - w
        return self.command(measurement, surface, switching, w=w), (measurement.t, w)


def main() -> None:
    """Prints a row for each controller, of the second half of its run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--duration", type=float, default=6.0, help="length of each run [s]")
    parser.add_argument("--out", type=Path, default=Path("runs/new"), help="folder of recordings")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    arm, disturbances = octarm.nominal_parameters(), [*map(parse_disturbance, DISTURBANCES)]
    believed = LagrangeModel(arm.mismatched(-0.3))
    K_s = 300.0 * apparent_mass(believed)  # alone, each coordinate's s decays at 300 1/s
    mine = LearningSlidingMode(nominal=believed, lambda_=80.0, K_s=K_s, L=60.0 * K_s)
    others = {name: make_controller(name, believed) for name in ("smc-boundary", "afsmc")}
    print("rms of       e_theta1 [rad]   error of tip [m]  dQ_theta1 [N m]")
    for name, controller in {**others, "mine": mine}.items():
        environment = octarm.load("sine", disturbances=disturbances)
        run = octarm.rollout(environment, controller, options.duration)
        late, theta1 = run.t > 0.5 * options.duration, arm.modules
        tip = np.linalg.norm((positions(run.q) - positions(run.q_d))[late, -1], axis=-1)
        columns = run.error[late, theta1], tip, np.diff(run.force[late, theta1])
        print(f"{name:<12}", *(f"{np.sqrt(np.mean(x * x)):16.1e}" for x in columns), run.message)
        write_recording(options.out / f"{name}.rrd", run, {"parameters": arm.to_dict()})
    print(f"wrote a recording of each into {options.out}; rerun opens them")


if __name__ == "__main__":
    main()

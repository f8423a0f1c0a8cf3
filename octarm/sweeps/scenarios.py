"""What controllers are tuned on, and what they are evaluated on afterwards; two lists, as data.

No reference, size of mismatch, kind of noise or other disturbance of the second list is in the
first one. A scenario more is a line more; its weight says what it counts beside the others. An
`Examination` says for how long they are tried, and under which noise.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from octarm.disturbances.actuators import ActuationDelay, DeadZone, Lag
from octarm.disturbances.episode import Disturbance
from octarm.disturbances.forces import BandLimitedNoise, StepForce
from octarm.disturbances.plant import Mismatch, Payload
from octarm.disturbances.sensors import MeasurementNoise


@dataclasses.dataclass(frozen=True, kw_only=True)
class Scenario:
    """What a controller is tried on; the true arm is the nominal one.

    Attributes:
        damping: factor on the damping of the arm, which its nominal model has, too [1].
        mismatch: of its nominal model, see `ArmParameters.mismatched` [1].
        noise: rms of the force on each joint over the amplitude of its input signal [1].
        correlation_time: of this noise [s].
        readings: rms of the noise of q, in shares of `NominalModel.scale` [1].
        period: between control actions [s].
        delay: of the inputs [s].
        lag: time constant of the inputs [s].
        dead_zone: of the inputs [N].
        payload: at the tip, from the start [kg].
        push: constant force on the tip, across the hanging arm, from 1.5 s on [N].
        plant_modules: modules of the plant, see `octarm.load`; 0 for those of the arm.
        weight: what the scenario counts [1].
    """

    reference: str
    damping: float = 1.0
    mismatch: float = 0.0
    noise: float = 0.0
    correlation_time: float = 0.01
    readings: float = 0.0
    period: float = 0.0005
    delay: float = 0.0
    lag: float = 0.0
    dead_zone: float = 0.0
    payload: float = 0.0
    push: float = 0.0
    plant_modules: int = 0
    weight: float = 1.0


SCENARIOS = (
    # The model is wrong, and noise acts: half of the design reference x mismatch x noise.
    Scenario(reference="sine", mismatch=-0.3),
    Scenario(reference="multi-sine"),
    Scenario(reference="sine", mismatch=0.3),
    Scenario(reference="multi-sine", mismatch=-0.3, noise=0.4),
    Scenario(reference="sine", noise=0.4),
    Scenario(reference="multi-sine", mismatch=0.3, noise=0.4),
    # Inertia and Coriolis forces count.
    Scenario(reference="fast-sine", mismatch=-0.3),
    Scenario(reference="fast-sine", mismatch=0.3, payload=0.1),
    # Four times the control period.
    Scenario(reference="multi-sine", mismatch=-0.3, noise=0.4, period=0.002),
    Scenario(reference="fast-sine", mismatch=0.3, noise=0.4, period=0.002),
    # Actuators are late, or slow.
    Scenario(reference="sine", mismatch=-0.3, noise=0.4, delay=0.0015),
    Scenario(reference="fast-sine", mismatch=0.3, noise=0.4, delay=0.0015),
    Scenario(reference="sine", mismatch=-0.3, noise=0.4, lag=0.005),
    Scenario(reference="fast-sine", mismatch=0.3, noise=0.4, lag=0.005),
    # The arm carries something.
    Scenario(reference="sine", payload=0.2),
    # The arm is not its model: three modules to each one of the controller's. A model that is too
    # heavy makes the gains larger, so this is the harder side.
    Scenario(reference="sine", mismatch=0.3, plant_modules=9),
    # The arm does not damp itself: a law that adapts has to, as on the published arms.
    Scenario(reference="sine", mismatch=0.3, noise=0.4, damping=0.02, period=0.002),
)

EVALUATION = (
    Scenario(reference="smooth-step", mismatch=-0.2),
    Scenario(reference="sine-slides", mismatch=0.2, noise=0.2, correlation_time=0.05),
    Scenario(reference="smooth-step", mismatch=0.15, readings=0.0005),
    Scenario(reference="sine-slides", mismatch=-0.15, period=0.001, push=0.5),
    Scenario(reference="smooth-step", period=0.001, delay=0.001, noise=0.2, correlation_time=0.05),
    Scenario(reference="sine-slides", dead_zone=0.5, lag=0.003),
)


# "tuning" in ASCII. Runs and sweeps have the seed that the user gives, 0 in the experiments.
_ENTROPY = int.from_bytes(b"tuning", "big")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Examination:
    """The scenarios, from when on and for how long [s] they last, and with which noise."""

    scenarios: tuple[Scenario, ...] = SCENARIOS
    begin: float = 1.0
    duration: float = 3.0
    noise: int = 0

    @property
    def seconds(self) -> float:
        """What a candidate is simulated for, all scenarios counted [s]."""
        return len(self.scenarios) * self.duration

    def mean(self, costs: np.ndarray) -> np.ndarray:
        """The weighted mean J of costs of shape (..., scenarios), shape (...) [1]."""
        weights = np.array([scenario.weight for scenario in self.scenarios])
        return np.sum(costs * weights, axis=-1) / np.sum(weights)

    def seeds(self) -> list[np.random.SeedSequence]:
        """One seed a scenario."""
        return [
            np.random.SeedSequence(_ENTROPY, spawn_key=(self.noise, i))
            for i in range(len(self.scenarios))
        ]


SHORT = Examination()
# Tells gains that drift, and those that suit one realisation of the noise only.
LONG = Examination(begin=2.0, duration=10.0, noise=1)
# What the gains are judged by afterwards.
UNSEEN = Examination(scenarios=EVALUATION, noise=2)


def disturbances(scenarios: Sequence[Scenario]) -> list[Disturbance]:
    """What acts on a batch with a scenario for each arm; what acts on none of them is left out."""

    def each(name: str) -> np.ndarray:
        return np.array([getattr(scenario, name) for scenario in scenarios])

    time = each("correlation_time")
    parts: dict[str, Disturbance] = {
        "damping": Mismatch(damping=each("damping")),
        "noise": BandLimitedNoise(ratio=each("noise")[:, None], correlation_time=time),
        "readings": MeasurementNoise(rms=each("readings")[:, None]),
        "delay": ActuationDelay(delay=each("delay")),
        "lag": Lag(time_constant=each("lag")[:, None]),
        "dead_zone": DeadZone(width=each("dead_zone")[:, None]),
        "payload": Payload(mass=each("payload")),
        "push": StepForce(amplitude=each("push"), at=1.5, on="tip-y"),
    }
    return [part for name, part in parts.items() if np.any(each(name) != getattr(Scenario, name))]

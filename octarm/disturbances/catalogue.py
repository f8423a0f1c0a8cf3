"""All disturbances, by the names that users give them.

To add one, write its class and its line in `DISTURBANCES`: commands, specs, `run.json` and the
ledger know it by its name and its fields.
"""

from __future__ import annotations

from octarm.disturbances.actuators import (
    ActuationDelay,
    DeadZone,
    Lag,
    LossOfEffectiveness,
    Saturation,
    SlewLimit,
)
from octarm.disturbances.drift import CyclicDrift, Drift
from octarm.disturbances.episode import Disturbance
from octarm.disturbances.forces import BandLimitedNoise, PulseForce, SineForce, StepForce
from octarm.disturbances.plant import GravityTilt, Mismatch, Payload, RandomMismatch
from octarm.disturbances.sensors import MeasurementDelay, MeasurementNoise, Quantisation

# In the order in which those of one family act, whatever the order in which they are listed.
DISTURBANCES: dict[str, type[Disturbance]] = {
    cls.name: cls
    for cls in (
        BandLimitedNoise,
        SineForce,
        PulseForce,
        StepForce,
        Mismatch,  # parameters of the bare arm, before it is loaded
        RandomMismatch,
        Drift,
        CyclicDrift,
        Payload,
        GravityTilt,
        ActuationDelay,  # from the controller to the plate: a line, a valve, a column
        DeadZone,
        Saturation,
        SlewLimit,
        Lag,
        LossOfEffectiveness,
        MeasurementDelay,  # reads the true motion
        MeasurementNoise,
        Quantisation,
    )
}

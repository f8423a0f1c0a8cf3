"""All disturbances, by the names that users give them.

To add one, write its class and its line in `DISTURBANCES`: commands, specs, `run.json`, the ledger
and the recordings then know it by its name and its fields.
"""

from __future__ import annotations

from octarm.disturbances import actuators, forces, plant, sensors
from octarm.disturbances.episode import Disturbance

# In the order in which those of one family act, whatever the order in which they are listed.
DISTURBANCES: dict[str, type[Disturbance]] = {
    cls.name: cls
    for cls in (
        forces.BandLimitedNoise,
        forces.SineForce,
        forces.PulseForce,
        forces.StepForce,
        plant.Mismatch,  # parameters of the bare arm, before it is loaded
        plant.RandomMismatch,
        plant.Drift,
        plant.CyclicDrift,
        plant.Payload,
        plant.GravityTilt,
        actuators.ActuationDelay,  # from the controller to the plate: a line, a valve, a column
        actuators.DeadZone,
        actuators.Saturation,
        actuators.SlewLimit,
        actuators.Lag,
        actuators.LossOfEffectiveness,
        sensors.MeasurementDelay,  # reads the true motion
        sensors.MeasurementNoise,
        sensors.Quantisation,
    )
}

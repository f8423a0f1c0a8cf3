"""The physics step of a sweep, against the fastest mode of every arm that its episodes have.

All episodes share one step, so that controllers and cells are compared alike. It is looked at
before any of them is run: an episode whose arm is too stiff for it would diverge, whatever the
controller.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from octarm.arm.groups import groups_of
from octarm.disturbances.episode import PlantChange
from octarm.errors import OctarmError
from octarm.simulation.steps import AUTO, StepError, check_arms, fitting_step, steps_of
from octarm.sweeps.plan import Arms, Plan
from octarm.sweeps.spec import SweepSpec


def with_step(spec: SweepSpec, *, probes: bool = False) -> SweepSpec:
    """The spec, whose physics step suits all of its arms; `auto` has become a number.

    With `probes` a few episodes are looked at, in which every value of every axis occurs. Raises
    OctarmError if the step is too long for an arm; the sentence names its episode.
    """
    plan = Plan(spec)
    alike = len(spec.controllers) * len(spec.references)  # in which the step is the same
    first = range(len(plan.shards) // alike)
    shards = plan.probes() if probes else (np.array(plan.shards[i]) for i in first)
    if not any(issubclass(spec.class_of(name), PlantChange) for name in spec.disturbances):
        first = range(0, len(plan.shards) // alike, plan.shards.pieces)
        shards = (np.array(plan.shards[i][:1]) for i in first)  # all arms of a plant are alike
    longest = min(_longest(spec, plan.arms(shard)) for shard in shards)
    if spec.timestep != AUTO:
        return spec
    step, period = fitting_step(longest, spec.control_period)
    return dataclasses.replace(spec, timestep=step, control_period=period)


def _longest(spec: SweepSpec, arms: Arms) -> float:
    """The longest stable step of some arms [s], or infinity for a given step that suits them."""
    arm = spec.arm(arms.arm)
    given = arm, arms.disturbances, arms.seeds, (len(arms.seeds),), spec.integrator
    groups = groups_of(arm, arms.plant_modules, arms.layout)
    if isinstance(spec.timestep, str):
        return float(np.min(steps_of(*given, groups)))
    try:
        check_arms(*given, spec.timestep, groups)
    except StepError as error:
        episode = arms.episodes[error.arm or 0]
        raise OctarmError(f"episode {episode}: {error.sentence}") from None
    return np.inf

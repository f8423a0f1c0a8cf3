"""What a step of a controller costs, against a step of the physics."""

from collections.abc import Callable, Mapping
from typing import Any

import mujoco.batch
import numpy as np

import octarm
from benchmarks.figures import LAW_OPERATIONS, Row, Settings, fastest
from controllers import make_controller
from octarm.arm.mjcf import build_slim_model, paper_order
from octarm.interfaces import Controller, Measurement, Reference
from octarm.lagrange import equilibrium

COMPARED = ("afsmc", "afsmc-consequent", "smc-boundary")
LIMITS = {"afsmc": (1.0, 250.0)}  # an arm of a batch, one arm alone [us]
PERIOD = 5e-4  # of control [s]


def controller_step(settings: Settings) -> list[Row]:
    """A controller's step, against one physics step of as many arms; the best of many."""
    arms, seconds = settings.arms, settings.seconds
    calls = [controller_call(name, (arms,)) for name in COMPARED]
    many = fastest(calls, seconds)
    alone = fastest([controller_call(name, ()) for name in COMPARED], seconds)
    slim = physics_step(build_slim_model(), arms)
    physics, after_physics = fastest([slim, calls[0]], seconds)
    rows: list[Row] = []
    for name, batch, single in zip(COMPARED, many, alone, strict=True):
        an_arm, one_arm = LIMITS.get(name, (None, None))
        rows.append(Row(f"{name}, an arm of {arms}", 1e6 * batch / arms, "us", an_arm))
        rows.append(Row(f"{name}, one arm alone", 1e6 * single, "us", one_arm))
    return [
        *rows,
        Row(f"RK4 step of the slim model, an arm of {arms}", 1e6 * physics / arms, "us"),
        Row(f"{COMPARED[0]} after it, caches cold", 1e6 * after_physics / arms, "us"),
        Row("the ratio of these two", after_physics / physics, "1", at_most=0.25),
        Row(f"{COMPARED[0]}, counted operations", 1e-9 * LAW_OPERATIONS * arms / many[0], "G/s"),
    ]


def physics_step(model: mujoco.MjModel, arms: int) -> Callable[[], None]:
    """One physics step of a batch in motion, on one thread."""
    draw = np.random.default_rng(0)
    batch = mujoco.batch.Batch(model, arms, 1)
    index, _ = paper_order(model)
    batch.bind("qpos")[:] = model.key("hanging").qpos
    batch.bind("qpos")[:, index] += moved(draw, arms, model.nq // 2)
    batch.bind("ctrl")[:] = draw.normal(size=(arms, model.nu))
    return batch.step


def moved(draw: np.random.Generator, arms: int, modules: int) -> np.ndarray:
    """Random displacements of arms of so many modules, shape (arms, 2N) [m], [rad]."""
    return np.repeat([0.015, 0.6], modules) / modules * draw.normal(size=(arms, 2 * modules))


def controller_call(
    name: str, batch: tuple[int, ...], gains: Mapping[str, Any] | None = None
) -> Callable[[], None]:
    """The next step of a controller whose arms are near what is wanted, within the layer."""
    arm = octarm.nominal_parameters()
    controller: Controller = make_controller(name, arm.mismatched(-0.3), gains)
    draw, size = np.random.default_rng(0), np.repeat([0.01, 0.3], arm.modules)

    def near(center: np.ndarray, scale: float) -> np.ndarray:
        # As in a sweep: the batch contiguous in memory.
        return np.asfortranarray(center + scale * size * draw.normal(size=(*batch, len(size))))

    q = near(equilibrium(arm), 1.0)
    v = near(np.zeros_like(q), 3.0)
    reference = Reference(near(q, 0.02), near(v, 0.5), near(np.zeros_like(q), 10.0))
    state, periods = controller.initial_state(batch), 0

    def step() -> None:
        nonlocal state, periods
        _, state = controller(state, Measurement(periods * PERIOD, q, v), reference)
        periods += 1

    return step

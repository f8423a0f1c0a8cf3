"""What things cost on one core of this machine, all measured in one run.

Run it: python scripts/benchmark.py [--arms 1024] [--seconds 1] [--json FILE]

A figure is the best of many repetitions: other programs only ever make one slower. To add figures,
write a function that returns rows, and its line in `SECTIONS`.
"""

import argparse
import json
import math
import platform
import time
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import NamedTuple

import mujoco.batch
import numpy as np

import octarm
from controllers import make_controller
from octarm.interfaces import Controller, Measurement, Reference
from octarm.lagrange import equilibrium

COMPARED = ("afsmc", "afsmc-consequent", "smc-boundary")
LIMITS = {"afsmc": (1.0, 250.0)}  # an arm of a batch, one arm alone [us]
PERIOD = 5e-4  # of control [s]


class Row(NamedTuple):
    """One figure.

    Attributes:
        name: what was measured.
        value: the figure.
        unit: its unit; 1 for a ratio.
        limit: what it should stay below; None where nothing is asked.
    """

    name: str
    value: float
    unit: str
    limit: float | None = None


class Settings(NamedTuple):
    """How much to measure.

    Attributes:
        arms: number of arms in a batch.
        seconds: how long each figure is repeated [s].
    """

    arms: int
    seconds: float


def controller_step(settings: Settings) -> list[Row]:
    """A controller's step, against one physics step of as many arms."""
    arms, seconds = settings
    calls = [controller_call(name, (arms,)) for name in COMPARED]
    many = fastest(calls, seconds)
    alone = fastest([controller_call(name, ()) for name in COMPARED], seconds)
    physics, after_physics = fastest([physics_step(arms), calls[0]], seconds)
    rows = []
    for name, batch, single in zip(COMPARED, many, alone, strict=True):
        an_arm, one_arm = LIMITS.get(name, (None, None))
        rows.append(Row(f"{name}, an arm of {arms}", 1e6 * batch / arms, "us", an_arm))
        rows.append(Row(f"{name}, one arm alone", 1e6 * single, "us", one_arm))
    return [
        *rows,
        Row(f"RK4 step, an arm of {arms}", 1e6 * physics / arms, "us"),
        Row(f"{COMPARED[0]} after it, caches cold", 1e6 * after_physics / arms, "us"),
        Row("the ratio of these two", after_physics / physics, "1", 0.25),
    ]


SECTIONS: dict[str, Callable[[Settings], list[Row]]] = {
    "controller step": controller_step,
}


def fastest(calls: Sequence[Callable[[], object]], seconds: float) -> list[float]:
    """The shortest time that each call took [s], in turns, so that all meet the same machine."""
    best = [math.inf] * len(calls)
    end = time.perf_counter() + seconds * len(calls)
    while time.perf_counter() < end:
        for i, call in enumerate(calls):
            begun = time.perf_counter()
            call()
            best[i] = min(best[i], time.perf_counter() - begun)
    return best


def physics_step(arms: int) -> Callable[[], None]:
    """One physics step of a batch in motion, on one thread."""
    model, draw = octarm.build_model(), np.random.default_rng(0)
    batch = mujoco.batch.Batch(model, arms, 1)
    moved = np.tile([0.005, 0.2], model.nq // 2) * draw.normal(size=(arms, model.nq))
    batch.bind("qpos")[:] = model.key("hanging").qpos + moved
    batch.bind("ctrl")[:] = draw.normal(size=(arms, model.nu))
    return batch.step


def controller_call(name: str, batch: tuple[int, ...]) -> Callable[[], None]:
    """The next step of a controller whose arms are near what is wanted, within the layer."""
    arm = octarm.nominal_parameters()
    controller: Controller = make_controller(name, arm.mismatched(-0.3))
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


def main() -> None:
    """Prints the table, and writes it as JSON where that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=1024, help="arms in a batch")
    parser.add_argument("--seconds", type=float, default=1.0, help="time spent on each figure [s]")
    parser.add_argument("--json", type=Path, metavar="FILE", help="also write the figures there")
    options = parser.parse_args()
    if options.arms < 1:
        parser.error(f"arms is {options.arms}; it must be at least 1")
    if not 0.0 < options.seconds <= 600.0:
        parser.error(f"seconds is {options.seconds:g}; it must be above 0 and at most 600")
    measured = {}
    for title, section in SECTIONS.items():
        measured[title] = section(Settings(options.arms, options.seconds))
        print(title)
        for name, value, unit, limit in measured[title]:
            verdict = "" if limit is None else f"  (limit {limit:g}{'' if value < limit else ' !'})"
            print(f"  {name:<36} {value:10.3f} {unit if unit != '1' else '':<3}{verdict}")
    if options.json is not None:
        figures = {title: [row._asdict() for row in rows] for title, rows in measured.items()}
        packages = {name: version(name) for name in ("numpy", "mujoco")}
        machine = {"platform": platform.platform(), "python": platform.python_version(), **packages}
        options.json.write_text(json.dumps({"machine": machine, **figures}, indent=2) + "\n")


if __name__ == "__main__":
    main()

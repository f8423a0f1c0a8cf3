"""How far the shards under way are, so that one sees a sweep move.

Who runs a shard notes in a file of the sweep's folder, about once a second, which share of it is
done. That works on any executor whose workers see the folder, and costs nothing where they do not.
"""

from __future__ import annotations

import contextlib
import shutil
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pyarrow as pa

from octarm.arm.parameters import ArmParameters
from octarm.interfaces import Command, Controller, Measurement, Reference
from octarm.sweeps.shards import Factory, run_shard
from octarm.sweeps.spec import SweepSpec

_EVERY = 1.0  # [s]


class Watched:
    """A controller that says when it is asked; all else is left to the one that it stands for."""

    def __init__(self, controller: Controller, tell: Callable[[float], object]) -> None:
        """A controller, and what to call at every control instant with its time [s]."""
        self._controller, self._tell = controller, tell

    def __getattr__(self, name: str) -> Any:
        return getattr(self._controller, name)

    def initial_state(self, batch_shape: tuple[int, ...] = ()) -> Any:
        """That of the controller."""
        return self._controller.initial_state(batch_shape)

    def __call__(
        self, state: Any, measurement: Measurement, reference: Reference
    ) -> tuple[Command, Any]:
        """What the controller answers."""
        self._tell(measurement.t)
        return self._controller(state, measurement, reference)


def watched(factory: Factory, tell: Callable[[float], object]) -> Factory:
    """A factory of the same controllers, each a `Watched` one."""

    def make(name: str, nominal: ArmParameters, gains: Mapping[str, Any]) -> Controller:
        return Watched(factory(name, nominal, gains), tell)

    return make


def run_noted_shard(spec: SweepSpec, shard: int, factory: Factory, note: Path) -> pa.Table:
    """`run_shard`, with a note on how far it is: the share that is done, in a file."""
    due = time.monotonic() + _EVERY

    def tell(t: float) -> None:
        nonlocal due
        if time.monotonic() >= due:
            due = time.monotonic() + _EVERY
            with contextlib.suppress(OSError):  # such as a folder that is not seen from here
                note.write_text(f"{t / spec.duration:.6f}", encoding="ascii")

    return run_shard(spec, shard, watched(factory, tell))


class Notes:
    """The notes of a sweep, read by who waits for its shards."""

    def __init__(self, folder: Path) -> None:
        """Notes in a folder of their own."""
        self._folder = folder
        self._known: dict[int, float] = {}

    def __enter__(self) -> Notes:
        self.__exit__()  # what a process that was killed has left
        with contextlib.suppress(OSError):
            self._folder.mkdir()
        return self

    def __exit__(self, *_: object) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)

    def file(self, shard: int) -> Path:
        """Where a shard that begins is to be noted."""
        self.forget(shard)
        return self._folder / str(shard)

    def share(self, shard: int) -> float:
        """Which share of a shard is done, as far as known [1]."""
        with contextlib.suppress(OSError, ValueError):  # none yet, or half of one
            text = (self._folder / str(shard)).read_text(encoding="ascii")
            self._known[shard] = min(1.0, max(0.0, float(text)))
        return self._known.get(shard, 0.0)

    def forget(self, shard: int) -> None:
        """A shard that is finished, or begins again."""
        self._known.pop(shard, None)
        with contextlib.suppress(OSError):
            (self._folder / str(shard)).unlink()

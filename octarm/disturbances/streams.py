"""What depends on time: random streams by name, noise held between two draws, and delays.

One `SeedSequence` belongs to one arm and one episode. Every stream is derived from it and from its
own name, so that what one stream draws depends neither on the other streams nor on their order.
An environment has one `SeedSequence` for each arm, from which those of its episodes are derived.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence

import numpy as np

from octarm.arrays import Entry
from octarm.errors import OctarmError

_BLOCK = 64  # holds an arm draws at once; the draws are the same for any number
NEVER = 2**62  # a step that no episode reaches


def stream(seed: np.random.SeedSequence, name: str) -> np.random.Generator:
    """The generator of this name for an arm in an episode: the same in every process."""
    return np.random.Generator(np.random.PCG64(_derived(seed, name)))


def episode_seed(seed: np.random.SeedSequence, index: int) -> np.random.SeedSequence:
    """The seed of an arm's episode of this number; that of episode 0 is the arm's seed itself."""
    return _derived(seed, "episode", index) if index else seed


def _derived(seed: np.random.SeedSequence, name: str, *numbers: int) -> np.random.SeedSequence:
    """A seed that no other name, number or arm has."""
    digest = hashlib.sha256(name.encode()).digest()
    words = (int.from_bytes(digest[i : i + 4], "little") for i in range(0, 16, 4))
    key = (*seed.spawn_key, *words, *numbers)
    return np.random.SeedSequence(seed.entropy, spawn_key=key, pool_size=seed.pool_size)


def in_steps(time: np.ndarray | float, timestep: float) -> np.ndarray:
    """A time [s] in steps [1], shape (...); a whole number where it is one but for rounding."""
    with np.errstate(over="ignore", invalid="ignore"):  # infinite, and inf - inf
        steps = np.asarray(time) / timestep
        whole = np.rint(steps)
        return np.where(np.abs(steps - whole) < 1e-6, whole, steps)


def first_step(time: np.ndarray | float, timestep: float) -> np.ndarray:
    """The first step that begins at or after a time [s], shape (...) of integers.

    For times so late that no episode reaches them it is `NEVER`.
    """
    return np.minimum(np.ceil(in_steps(time, timestep)), NEVER).astype(np.int64)


def periods_begun(step: int, timestep: float, period: np.ndarray | float) -> np.ndarray | int:
    """How many whole periods [s] have passed when a step begins, shape (...) of integers.

    It is the same for any timestep that leads to this instant.
    """
    passed = step * timestep / period * (1.0 + 1e-15) + 1e-9
    if isinstance(passed, float):
        return math.floor(passed)
    return np.floor(passed).astype(np.int64)


class HeldNoise:
    """Normal numbers times a scale, held: draw h of an arm's generator from h t_c to (h+1) t_c.

    White up to its corner: the one-sided spectral density is 2 t_c sinc^2(f t_c), half of which is
    left at f = 0.443 / t_c. The value at an instant depends on the generator and t_c alone: not on
    the timestep, on how often or when it was asked for, nor on the batch.

    Attributes:
        scale: rms of each number, shape (..., k).
    """

    def __init__(
        self,
        generators: Sequence[np.random.Generator],
        scale: np.ndarray,
        correlation_time: np.ndarray | float,
        timestep: float,
    ) -> None:
        """Noise from its beginning, of a generator for each arm, used by nothing else.

        t_c, how long a draw is held, has shape () or the batch's [s]; at least a timestep [s].
        """
        least = float(np.min(correlation_time))
        if float(in_steps(least, timestep)) < 1.0:
            raise OctarmError(
                f"the correlation time of a noise is {least:g} s; it must be at least the physics "
                f"step, {timestep:g} s"
            )
        self.scale = np.asfortranarray(scale)
        self._generators = generators
        self._correlation_time = correlation_time
        self._timestep = timestep
        self._draws = np.empty((_BLOCK, scale.shape[-1], len(generators)))
        self._block: np.ndarray | int = -1  # of the draws at hand: one number, or each arm's
        self._hold: np.ndarray | int = -1
        self._step, self._next = 0, 0  # `_held` is valid in between
        self._held = np.empty(0)

    def __call__(self, step: int) -> np.ndarray:
        """The numbers at a physics step, shape (..., k); read-only, one object a hold."""
        if self._step <= step < self._next:
            return self._held
        if step < self._step:
            raise OctarmError(f"noise was asked for at step {step} after step {self._step}")
        hold = periods_begun(step, self._timestep, self._correlation_time)
        if np.count_nonzero(hold != self._hold):
            self._hold, self._held = hold, self._take(hold)
        ends = (hold + 1) * self._correlation_time / self._timestep
        first = ends if isinstance(ends, float) else float(np.min(ends))
        self._step, self._next = step, max(step + 1, math.ceil(first - 1e-6))
        return self._held

    def _take(self, hold: np.ndarray | int) -> np.ndarray:
        """The numbers of this hold, or of one for each arm, shape (..., k)."""
        block, place = hold // _BLOCK, hold % _BLOCK
        if np.count_nonzero(block != self._block):
            ahead = np.broadcast_to(np.asarray(block) - self._block, len(self._generators)).tolist()
            for i, (generator, blocks) in enumerate(zip(self._generators, ahead, strict=True)):
                for _ in range(blocks):  # more than one when some were skipped
                    self._draws[:, :, i] = generator.standard_normal(self._draws.shape[:2])
            self._block = block
        if isinstance(place, int):
            drawn = self._draws[place]
        else:
            drawn = np.take_along_axis(self._draws, place[None, None, :], axis=0)[0]
        held = self.scale * drawn.T.reshape(self.scale.shape)
        held.setflags(write=False)
        return held


class DelayLine:
    """The last rows, as many as the longest delay takes; before the first row all are zero.

    A delay is `steps` whole physics steps and a `rest`, a fraction of one more.

    Attributes:
        steps: whole steps in it, shape (...) of integers.
        rest: what is left, in physics steps, shape (...) [1]; 0 where there are whole steps only.
        timestep: physics step [s].
        fractions: whether there is a rest for some arm.
    """

    def __init__(self, delay: Entry, timestep: float, batch_shape: tuple[int, ...]) -> None:
        """An empty line; the delay has shape () or the batch's [s], the physics step is in [s]."""
        steps = np.broadcast_to(in_steps(delay, timestep), batch_shape)
        self.steps = np.floor(steps).astype(np.int64)
        self.rest = steps - self.steps
        self.fractions = bool(np.any(self.rest > 0.0))
        self.timestep = timestep
        self._length = int(np.max(np.ceil(steps))) + 1
        self._ring = np.empty(0)
        self._place = np.empty(0, dtype=np.int64)

    def put(self, step: int, *rows: np.ndarray) -> None:
        """Keeps what belongs to a step: arrays of one shape (..., 2N), the same number always."""
        if not self._ring.size:  # the arms' axis is last, so that it is contiguous
            shape = (len(rows), *rows[0].T.shape)
            self._ring = np.zeros_like(rows[0], shape=(self._length, *shape))
            self._place = np.arange(math.prod(shape)).reshape(shape)
        for kept, row in zip(self._ring[step % self._length], rows, strict=True):
            kept[...] = row.T

    def take(self, steps: np.ndarray) -> list[np.ndarray]:
        """What was put at these steps, one an arm, shape (...): arrays of shape (..., 2N)."""
        row = steps % self._length
        return [kept.T for kept in self._ring.take(self._place + row * self._place.size)]

"""Gymnasium's environments: one arm, and many as a batch."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from octarm.errors import OctarmError
from octarm.gym.arms import Arms

_MOST_SPARE = 8  # batches of arms that are kept


class TrackEnv(gymnasium.Env[np.ndarray, np.ndarray]):
    """One arm; see `octarm.gym`."""

    metadata: dict[str, Any] = {"render_modes": []}  # noqa: RUF012 (Gymnasium's own type)

    def __init__(self, **setting: Any) -> None:
        """An arm; the arguments are those of `Arms`."""
        self._arms = Arms(**setting)
        self.observation_space = self._arms.observation_space
        self.action_space = self._arms.action_space
        self._over = True

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """The next episode, whose seed is drawn; the same again after the same seed.

        Returns:
            The first observation, shape (8N,), and the drawn seed.
        """
        super().reset(seed=seed, options=options)
        drawn = _seed(self.np_random)
        self._over = False
        return self._arms.begin([drawn]), {"seed": drawn}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """One control period with an action of shape (2N,) [1].

        Raises OctarmError if the episode is over.
        """
        if self._over:
            raise OctarmError("the episode is over; reset begins the next one")
        seen, reward, lost, self._over = self._arms.step(action)
        return seen, float(reward), bool(lost), self._over and not lost, {}


@dataclasses.dataclass(eq=False)
class _Group:
    """Arms of a vector that began together."""

    arms: Arms
    rows: np.ndarray  # of the vector, shape (k,)
    alive: np.ndarray  # which of them are not over, shape (k,) of bool


class TrackVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """Many arms; see `octarm.gym`.

    Arms whose episode is over begin the next one at the next step, whose action they ignore. Those
    that begin together are stepped as one batch from then on.
    """

    def __init__(self, num_envs: int = 1, **setting: Any) -> None:
        """So many arms; the other arguments are those of `Arms`."""
        self.metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}
        self.num_envs, self._setting = num_envs, setting
        self._spare = {num_envs: Arms(**setting, arms=num_envs)}
        first = self._spare[num_envs]
        self.single_observation_space = first.observation_space
        self.single_action_space = first.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._seen = np.zeros((num_envs, *first.observation_space.shape), np.float32)
        self._generators: list[np.random.Generator] = [np_random()[0] for _ in range(num_envs)]
        self._groups: list[_Group] = []
        self._over = np.ones(num_envs, dtype=bool)

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[np.ndarray, dict[str, Any]]:
        """New episodes of all arms, or of those of `options["reset_mask"]`.

        Arm i is that of one environment alone with the seed `seed + i`, or the i-th one of a list.
        The observations have shape (n, 8N).
        """
        super().reset(seed=seed if isinstance(seed, int) else None)
        seeds = range(seed, seed + self.num_envs) if isinstance(seed, int) else seed
        rows = np.flatnonzero((options or {}).get("reset_mask", np.ones(self.num_envs, dtype=bool)))
        for i, each in enumerate(seeds or ()):
            if each is not None and i in rows:
                self._generators[i] = np_random(each)[0]
        info = self._begin(rows)
        return self._seen.copy(), info

    def step(
        self, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """One control period with actions of shape (n, 2N) [1].

        Arms that were over, or have not begun, begin anew instead.
        """
        again, actions = np.flatnonzero(self._over), np.asarray(actions)
        rewards = np.zeros(self.num_envs)
        terminations, truncations = np.zeros((2, self.num_envs), dtype=bool)
        for group in self._groups:
            seen, reward, lost, over = group.arms.step(actions[group.rows])
            rows, of = group.rows[group.alive], group.alive
            self._seen[rows], rewards[rows] = seen[of], reward[of]
            terminations[rows], truncations[rows] = lost[of], over & ~lost[of]
            group.alive = of & ~lost & (not over)
        self._over = terminations | truncations
        self._tidy()
        info = self._begin(again) if again.size else {}
        return self._seen.copy(), rewards, terminations, truncations, info

    def _begin(self, rows: np.ndarray) -> dict[str, Any]:
        """New episodes of these rows, as one group; their seeds, as Gymnasium has them."""
        for group in self._groups:
            group.alive &= ~np.isin(group.rows, rows)
        self._tidy()
        size, seeds = len(rows), np.zeros(self.num_envs, dtype=np.int64)
        seeds[rows] = [_seed(self._generators[int(i)]) for i in rows]
        arms = self._spare.pop(size, None) or Arms(**self._setting, arms=size)
        self._seen[rows] = arms.begin(seeds[rows].tolist())
        self._groups.append(_Group(arms, rows, np.ones(size, dtype=bool)))
        self._over[rows] = False
        return {"seed": seeds, "_seed": np.isin(np.arange(self.num_envs), rows)}

    def _tidy(self) -> None:
        """Puts groups aside of which no arm is left; some are kept to be used again."""
        for group in self._groups:
            if not group.alive.any() and len(self._spare) < _MOST_SPARE:
                self._spare[len(group.rows)] = group.arms
        self._groups = [group for group in self._groups if group.alive.any()]


def _seed(generator: np.random.Generator) -> int:
    """The seed of the next episode."""
    return int(generator.integers(2**63 - 1))

"""Learns a policy by augmented random search, and writes it as a controller of your own.

A residual on PD: input forces that are linear in what is wanted and in the errors. Each iteration
tries random changes of the weights, both ways, as one batch of arms, and moves the weights along
those that changed the return most (Mania, Guy and Recht, NeurIPS 2018).
Run it: python scripts/learn.py [--quick] [--out DIR]
It needs the extra gym, and is far faster with the extra fast.
"""

import argparse
import time
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

import octarm
import octarm.gym  # registers the environment
from controllers import make_controller
from octarm.arm.nominal import LagrangeModel
from octarm.simulation.engines import usual_engine

BASE, SHARE = "pd", 0.1  # the controller below, and the share of the input range that is added
DIRECTIONS, KEPT = 32, 16
TRIED, MOVED, SHRINK = 2e-3, 8e-3, 0.94  # sizes of a trial and of a move, and their decay
LEAST = 0.1  # by which a feature is divided that hardly varies
POLICY = Path(__file__).with_name("learned_policy.txt")
SWEEP = """seed = 0
episodes = {episodes}
duration = {duration}
reference = "sine"
[grid]
controller = ["pd", "./policy.py:Learned"]
[grid.disturbance]
noise = [0.0, 0.2]
"""


def arms(directions: int, duration: float) -> Any:
    """The task for so many changes, tried both ways, and for the policy itself."""
    return gymnasium.make_vec(
        "octarm/Track-v0", num_envs=1 + 2 * directions, controller=BASE, residual=SHARE,
        duration=duration, engine=usual_engine(),
    )  # fmt: skip


def features(seen: np.ndarray) -> np.ndarray:
    """1, q_d, q_d', e and e' of observations, shape (n, 1 + 8N), in the units of `octarm.gym`."""
    q, v, e, e_dot = np.split(seen.astype(np.float64), 4, axis=1)
    return np.concatenate([np.ones((len(q), 1)), q - e, v - e_dot, e, e_dot], axis=1)


def play(env: Any, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The mean reward of each policy over an episode, and the rms of features under the first one.

    The weights have shape (n, 2N, 1 + 8N). What follows after an arm has diverged is worth nothing.
    """
    seen, _ = env.reset(seed=0)
    going, total, squares, steps = np.ones(len(weights), dtype=bool), 0.0, 0.0, 0
    while going.any():
        x = features(seen)
        actions = np.einsum("nij,nj->ni", weights, x).astype(np.float32)
        seen, rewards, terminated, truncated, _ = env.step(actions)
        total, squares, steps = total + going * rewards, squares + x[0] * x[0], steps + 1
        going &= ~(terminated | truncated)
    return np.asarray(total) / steps, np.sqrt(squares / steps)


def search(env: Any, iterations: int, seed: int) -> np.ndarray:
    """The best weights of all iterations, shape (2N, 1 + 8N), by augmented random search."""
    arms, inputs = env.action_space.shape
    directions = arms // 2
    random, weights = np.random.default_rng(seed), np.zeros((inputs, 1 + 4 * inputs))
    base: Any = make_controller(BASE, octarm.nominal_parameters())
    gains = base.K_p[inputs // 2 :]
    eager = np.repeat(gains / np.max(gains), 2)[:, None]  # little where a bend gives way easily
    best, best_return = weights, -np.inf
    _, size = play(env, np.zeros((arms, *weights.shape)))
    size = np.maximum(size, LEAST)
    for k in range(iterations):
        shrunk = SHRINK**k
        changes = eager * random.standard_normal((directions, *weights.shape))
        tried = [
            weights[None],
            weights + TRIED * shrunk * changes,
            weights - TRIED * shrunk * changes,
        ]
        returns, _ = play(env, np.concatenate(tried) / size)
        if returns[0] > best_return:
            best, best_return = weights / size, float(returns[0])
        if k % 5 == 0:
            print(f"iteration {k:3}: return {returns[0]:.6f}, {time.process_time():.0f} s of CPU")
        plus, minus = returns[1 : 1 + directions], returns[1 + directions :]
        kept = np.argsort(-np.maximum(plus, minus))[: max(1, KEPT * directions // DIRECTIONS)]
        spread = np.std(np.concatenate([plus[kept], minus[kept]])) or 1.0
        move = np.einsum("k,kij->ij", plus[kept] - minus[kept], changes[kept])
        weights = weights + MOVED * shrunk / (len(kept) * spread) * move
    return best


def in_si(weights: np.ndarray) -> np.ndarray:
    """Weights for features in SI instead, that give input forces, shape (2N, 1 + 8N) [N]."""
    model = LagrangeModel(octarm.nominal_parameters())
    low, high = model.input_range
    n = model.coordinates
    unit = model.scale * np.repeat([0.1, 1.0], n // 2)
    out = weights / np.concatenate([[1.0], np.tile(unit, 4)])
    out[:, 0] -= out[:, 1 : 1 + n] @ model.equilibrium()
    return SHARE * 0.5 * (high - low)[:, None] * out


def write_policy(file: Path, weights: np.ndarray) -> None:
    """Writes a controller with these weights of `in_si`, shape (2N, 1 + 8N)."""
    rows = ",\n".join(f"    {row.tolist()}" for row in weights)
    text = POLICY.read_text(encoding="utf-8").replace("[WEIGHTS]", f"[\n{rows},\n]")
    file.write_text(text, encoding="utf-8")


def main() -> None:
    """Searches, writes the policy and a sweep, and compares with PD."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/learned"), help="folder for it")
    parser.add_argument("--seed", type=int, default=0, help="of the search")
    parser.add_argument("--iterations", type=int, default=40)
    parser.add_argument(
        "--quick", action="store_true", help="a glance: a short episode, few trials"
    )
    options = parser.parse_args()
    directions, duration = (4, 0.2) if options.quick else (DIRECTIONS, 2.0)
    iterations = 3 if options.quick else options.iterations
    weights = in_si(search(arms(directions, duration), iterations, options.seed))
    options.out.mkdir(parents=True, exist_ok=True)
    policy, sweep = options.out / "policy.py", options.out / "sweep.toml"
    write_policy(policy, weights)
    episodes, length = (2, 0.5) if options.quick else (6, 10.0)
    sweep.write_text(SWEEP.format(episodes=episodes, duration=length), encoding="utf-8")
    for name in (BASE, f"{policy}:Learned"):
        law = make_controller(name, octarm.nominal_parameters())
        run = octarm.rollout(octarm.load("sine"), law, length)
        rms = np.sqrt(np.mean(run.error**2, axis=0))
        print(f"{name:>30}: rms", *(f"{x:.2e}" for x in rms), run.message)
    print(f"octarm sweep {sweep} --out {options.out}/sweep && octarm report {options.out}/sweep")


if __name__ == "__main__":
    main()

"""The script that learns a policy: the same one twice, which runs like any controller."""

import runpy
import sys
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import octarm
from controllers import make_controller
from octarm.commands.cli import main

SCRIPT = Path(__file__).resolve().parent.parent / "scripts" / "learn.py"


def learned(folder: Path, monkeypatch: pytest.MonkeyPatch, *options: str) -> Path:
    monkeypatch.setattr(sys, "argv", [SCRIPT.name, "--quick", "--out", str(folder), *options])
    runpy.run_path(str(SCRIPT), run_name="__main__")
    return folder / "policy.py"


@pytest.mark.slow
def test_a_learned_policy_is_the_same_twice_and_swept_and_reported(tmp_path, monkeypatch):
    texts = [learned(tmp_path / name, monkeypatch).read_text("utf-8") for name in "ab"]
    assert texts[0] == texts[1] != learned(tmp_path / "c", monkeypatch, "--seed", "1").read_text()
    out = tmp_path / "a" / "sweep"
    assert main(["sweep", str(tmp_path / "a" / "sweep.toml"), "--out", str(out)]) == 0
    assert main(["report", str(out)]) == 0
    table = octarm.read_sweep(out, ["controller", "status"]).to_pydict()
    assert set(table["controller"]) == {"pd", "Learned"} and set(table["status"]) == {"ok"}
    assert "Learned" in (out / "report" / "report.html").read_text("utf-8")


def test_the_policy_adds_what_its_actions_did_in_the_environment(tmp_path, monkeypatch):
    """Weights in SI, within a controller, are those on observations, within the environment."""
    names: dict[str, Any] = runpy.run_path(str(SCRIPT))
    weights = np.random.default_rng(0).normal(size=(6, 25)) * 1e-3
    policy = tmp_path / "policy.py"
    names["write_policy"](policy, names["in_si"](weights))
    law = make_controller(f"{policy}:Learned", octarm.nominal_parameters())
    run = octarm.rollout(octarm.load("sine"), law, 0.1)
    env: Any = gymnasium.make("octarm/Track-v0", controller="pd", residual=0.1).unwrapped
    seen, _ = env.reset(seed=0)
    for k in range(199):
        seen, *_ = env.step((weights @ names["features"](seen[None])[0]).astype(np.float32))
        q = env._arms._environment.physics.q()
        np.testing.assert_allclose(q, run.q[k + 1], rtol=0.0, atol=1e-7)
    assert np.max(np.abs(run.signals["learned"])) > 1e-3


def test_a_policy_of_nothing_is_pd_for_one_arm_and_many(tmp_path):
    names: dict[str, Any] = runpy.run_path(str(SCRIPT))
    policy = tmp_path / "policy.py"
    names["write_policy"](policy, np.zeros((6, 25)))
    arm = octarm.nominal_parameters()
    laws = [make_controller(name, arm) for name in ("pd", f"{policy}:Learned")]
    runs = [octarm.rollout(octarm.load("sine"), law, 0.05) for law in laws]
    np.testing.assert_array_equal(runs[0].q, runs[1].q)


@pytest.mark.slow
def test_the_search_finds_weights_that_beat_pd():
    """In a few iterations, half a minute of CPU."""
    names: dict[str, Any] = runpy.run_path(str(SCRIPT))
    env = names["arms"](16, 1.0)
    nothing = np.zeros((33, 6, 25))
    before, _ = names["play"](env, nothing)
    best = names["search"](env, 12, seed=0)
    after, _ = names["play"](env, nothing + best)
    assert 1.0 - after[0] < 0.9 * (1.0 - before[0])

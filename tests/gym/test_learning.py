"""Policies that nobody designed hover."""

from __future__ import annotations

import os
from typing import Any

import numpy as np
import pytest

gymnasium = pytest.importorskip("gymnasium", reason="skipped: no gymnasium")

from heli_lab.apps.gym import LinearPolicy, cross_entropy, mean_return  # noqa: E402

pytestmark = pytest.mark.slow

SEEDS = range(10**6, 10**6 + 10)
"""Episodes that nothing was searched or learned with."""
LONG = os.environ.get("HELI_LONG") == "1"


def test_the_cross_entropy_method_finds_gains_that_hover() -> None:
    env = gymnasium.make("HeliHover-v0")
    generations, required = (15, 460.0) if LONG else (5, 380.0)
    policy = cross_entropy(env, generations=generations, population=20 if LONG else 12, episodes=2)
    searched, idle = mean_return(env, policy, SEEDS), mean_return(env, LinearPolicy(np.zeros((2, 8))), SEEDS)
    # 500 is the best return. Hover voltages alone let most arms sink or rise on rigs within the tolerances
    # of the file.
    assert idle < 320.0 and searched > required


def test_ppo_of_stable_baselines3_learns_to_hover() -> None:
    pytest.importorskip("stable_baselines3", reason="skipped: no stable-baselines3")
    from stable_baselines3 import PPO
    from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize

    # As docs/how-to/gymnasium.md has it, for a fifth of its steps.
    four = DummyVecEnv([lambda: gymnasium.make("HeliHover-v0")] * 4)
    normalised = VecNormalize(four, gamma=0.98)
    ppo = PPO(
        "MlpPolicy",
        normalised,
        seed=1,
        device="cpu",
        n_steps=500,
        batch_size=500,
        n_epochs=8,
        gamma=0.98,
        learning_rate=1e-3,
        policy_kwargs={"net_arch": [32, 32], "log_std_init": -0.7},
    )
    ppo.learn(40_000)
    env = gymnasium.make("HeliHover-v0")

    def policy(seen: Any) -> Any:
        action, _ = ppo.predict(normalised.normalize_obs(seen), deterministic=True)
        return action

    # Holding the voltages at which the rig hovers by its file earns 260.
    assert mean_return(env, policy, SEEDS) > 350.0

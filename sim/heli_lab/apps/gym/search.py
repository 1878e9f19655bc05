"""Optimise linear policies by the cross-entropy method, without a learning library.

After Rubinstein, *The cross-entropy method for combinatorial and continuous optimization*, Methodology and
Computing in Applied Probability 1 (1999). The decreasing noise of Szita and Lorincz, Neural Computation 18
(2006), prevents the search from converging too early.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from heli_host.data.arrays import Floats

from heli_lab.apps.gym.environment import Action, Observation


@dataclass(frozen=True)
class LinearPolicy:
    """Policy whose action is a gain matrix times the observation.

    Parameters
    ----------
    gains : ndarray (2, 8)
        Gains of the front and back action, per unit of the observation.
    """

    gains: Floats

    def __call__(self, observation: Observation) -> Action:
        """Return the action, float32 of shape (2,) and clipped at 1, for an `observation` of shape (8,)."""
        return np.clip(self.gains @ observation, -1.0, 1.0).astype(np.float32)


def mean_return(env: gymnasium.Env[Any, Any], policy: Callable[[Observation], Action], seeds: range) -> float:
    """Fly one episode per seed and average the returns.

    Parameters
    ----------
    env : gymnasium.Env
        Environment that ends episodes by time, as those of `gymnasium.make` do.
    policy : callable taking an observation, returning an action
        Controller of all episodes.
    seeds : range
        One seed of the environment per episode.

    Returns
    -------
    float
        Mean over the episodes of the sum of rewards.
    """
    total = 0.0
    for seed in seeds:
        observation, _ = env.reset(seed=seed)
        has_ended = False
        while not has_ended:
            observation, reward, terminated, truncated, _ = env.step(policy(observation))
            total += float(reward)
            has_ended = terminated or truncated
    return total / len(seeds)


def cross_entropy(
    env: gymnasium.Env[Any, Any],
    *,
    generations: int = 20,
    population: int = 24,
    episodes: int = 2,
    seed: int = 1,
) -> LinearPolicy:
    """Optimise a linear policy: two gains of elevation on the sum of the voltages, four on their difference.

    Each generation draws gains from a normal distribution, flies them, and fits the distribution to the best
    quarter. All policies of a generation fly the same episodes.

    Parameters
    ----------
    env : gymnasium.Env
        Environment as in `mean_return`.
    generations : int
        Number of generations.
    population : int
        Number of policies per generation.
    episodes : int
        Number of episodes per policy.
    seed : int
        Seed of the random gains.

    Returns
    -------
    LinearPolicy
        The mean of the last distribution.
    """
    random = np.random.default_rng(seed)
    mean, deviation = np.zeros(6), np.full(6, 2.0)
    elite_count = max(population // 4, 2)
    for generation in range(generations):
        drawn = mean + deviation * random.standard_normal((population, 6))
        seeds = range(1000 * generation, 1000 * generation + episodes)
        returns = [mean_return(env, _policy_of_gains(weights), seeds) for weights in drawn]
        elite = drawn[np.argsort(returns)[-elite_count:]]
        mean = elite.mean(axis=0)
        # The noise of Szita and Lorincz: a tenth of the initial deviation at first, 0 at the end.
        deviation = elite.std(axis=0) + 0.2 * (1.0 - (generation + 1) / generations)
    return _policy_of_gains(mean)


def _policy_of_gains(weights: Floats) -> LinearPolicy:
    """Build a policy from six gains: of angle and rate, for elevation, pitch and travel in this order."""
    # Observation: angles of the three axes 0 to 2, their rates 3 to 5, last action 6 and 7.
    collective, differential = np.zeros(8), np.zeros(8)
    collective[[0, 3]] = weights[:2]
    differential[[1, 4]] = weights[2:4]
    differential[[2, 5]] = weights[4:]
    # Action: front and back.
    return LinearPolicy(np.vstack((collective + differential, collective - differential)))

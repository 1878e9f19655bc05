"""Policies without a learning library: a matrix of gains, found by the cross-entropy method.

After Rubinstein, *The cross-entropy method for combinatorial and continuous optimization*, Methodology and
Computing in Applied Probability 1 (1999), with the decreasing noise of Szita and Lorincz, Neural Computation
18 (2006), without which the search stops too soon.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from heli_host.arrays import Floats

from heli_lab.gym.environment import Action, Observation


@dataclass(frozen=True)
class LinearPolicy:
    """Actions that are gains times what is seen.

    Parameters
    ----------
    gains : ndarray (2, 8)
        Of front and back, in actions per unit of the observation.
    """

    gains: Floats

    def __call__(self, observation: Observation) -> Action:
        """Choose an action for an `observation`, shape (8,): float32, shape (2,), cut off at 1."""
        return np.clip(self.gains @ observation, -1.0, 1.0).astype(np.float32)


def mean_return(env: gymnasium.Env[Any, Any], policy: Callable[[Observation], Action], seeds: range) -> float:
    """Fly an episode from each seed.

    Parameters
    ----------
    env : gymnasium.Env
        Where; it has to end episodes by time, as environments of `gymnasium.make` do.
    policy : callable taking an observation, returning an action
        What flies.
    seeds : range
        Seeds of the episodes.

    Returns
    -------
    float
        Mean sum of rewards of an episode.
    """
    total = 0.0
    for seed in seeds:
        observation, _ = env.reset(seed=seed)
        ended = False
        while not ended:
            observation, reward, terminated, truncated, _ = env.step(policy(observation))
            total += float(reward)
            ended = terminated or truncated
    return total / len(seeds)


def cross_entropy(
    env: gymnasium.Env[Any, Any],
    *,
    generations: int = 20,
    population: int = 24,
    episodes: int = 2,
    seed: int = 1,
) -> LinearPolicy:
    """Search the gains of six measured quantities: of the sum of both voltages and of their difference.

    Each generation draws gains from a normal distribution, flies them, and fits the distribution to the best
    quarter. All policies of a generation fly the same episodes.

    Parameters
    ----------
    env : gymnasium.Env
        As in `mean_return`.
    generations : int
        How often.
    population : int
        Policies in each.
    episodes : int
        Episodes that each policy flies.
    seed : int
        Seed of everything random.

    Returns
    -------
    LinearPolicy
        The mean of the last distribution.
    """
    random = np.random.default_rng(seed)
    mean, deviation = np.zeros(6), np.full(6, 2.0)
    best = max(population // 4, 2)
    for generation in range(generations):
        drawn = mean + deviation * random.standard_normal((population, 6))
        seeds = range(1000 * generation, 1000 * generation + episodes)
        returns = [mean_return(env, _policy(weights), seeds) for weights in drawn]
        chosen = drawn[np.argsort(returns)[-best:]]
        mean = chosen.mean(axis=0)
        # Szita and Lorincz' noise, a tenth of the first spread at the beginning and none at the end.
        deviation = chosen.std(axis=0) + 0.2 * (1.0 - (generation + 1) / generations)
    return _policy(mean)


def _policy(numbers: Floats) -> LinearPolicy:
    """Gains of elevation and its rate on both rotors, of the rest on their difference."""
    both, apart = np.zeros(8), np.zeros(8)
    both[[0, 3]] = numbers[:2]
    apart[[1, 4, 2, 5]] = numbers[2:]
    return LinearPolicy(np.vstack((both + apart, both - apart)))

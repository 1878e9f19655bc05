"""The helicopter as a Gymnasium environment, for learned control laws.

Importing it registers ``HeliHover-v0``, so ``gymnasium.make("heli_lab.gym:HeliHover-v0")`` needs no import.
"""

from __future__ import annotations

from heli_host.errors import install_remedy

from heli_lab.errors import LearningError

try:
    import gymnasium
except ImportError as missing:
    raise LearningError("heli_lab.apps.gym needs gymnasium", install_remedy("gym")) from missing

from heli_lab.apps.gym.environment import EPISODE_S, ACTION_STEP_s, HoverEnv
from heli_lab.apps.gym.search import LinearPolicy, cross_entropy, mean_return
from heli_lab.apps.gym.simulator import Domain

__all__ = ["EPISODE_S", "ACTION_STEP_s", "Domain", "HoverEnv", "LinearPolicy", "cross_entropy", "mean_return"]

gymnasium.register(
    "HeliHover-v0", "heli_lab.apps.gym:HoverEnv", max_episode_steps=round(EPISODE_S / ACTION_STEP_s)
)

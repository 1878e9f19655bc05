"""Registers ``HeliHover-v0`` when imported: ``gymnasium.make("heli_lab.gym:HeliHover-v0")``."""

from heli_lab.apps.gym import *  # noqa: F403 - Gymnasium imports this short name, and nothing of it directly

"""Skips this folder where the emulator is not built, and builds programs for it."""

import importlib.util

from due_chip import build

__all__ = ["build"]

collect_ignore_glob: list[str] = []
if importlib.util.find_spec("due_emulator._due") is None:
    collect_ignore_glob = ["test_*.py"]

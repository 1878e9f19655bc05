"""Fixtures of this room."""

from __future__ import annotations

from tests.cli.terminal import terminal

__all__ = ["terminal"]

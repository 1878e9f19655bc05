"""Fixtures of this room."""

from __future__ import annotations

import re

import pytest
from heli_lab.explain import experiment_design

from tests.cli.terminal import terminal
from tests.running.long import LONG

__all__ = ["short_plans", "terminal"]


@pytest.fixture
def short_plans(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let a sine of a proposed flight last one period, and a pause 20 s, except in `make long`."""
    if not LONG:
        shorter = {
            key: (
                purpose,
                re.sub(r"(period_s = )(\d+)\nduration_s = \d+", r"\1\2\nduration_s = \2", plan).replace(
                    "duration_s = 60", "duration_s = 20"
                ),
            )
            for key, (purpose, plan) in experiment_design._SEGMENTS.items()
        }
        monkeypatch.setattr(experiment_design, "_SEGMENTS", shorter)

"""Simulated flights assert what the proofs of the flight code assume."""

from __future__ import annotations

import pytest
from heli_test_native import proofs


@pytest.mark.parametrize(
    ("member", "claim"),
    [
        ("none", ""),
        ("decoded_count", "parser"),
        ("busy", "exchange"),
        ("reply_size", "exchange"),
        ("fault", "supervisor"),
        ("exciter", "supervisor"),
        ("flying", "upload"),
        ("parameters", "interpreter"),
        ("program_end", "verifier"),
        ("max_duty", "duty"),
        ("differential", "mixer"),
        ("slew", "setpoints"),
        ("path", "setpoints"),
    ],
)
def test_a_broken_invariant_is_noticed(member: str, claim: str) -> None:
    assert proofs.broken_by(member) == claim

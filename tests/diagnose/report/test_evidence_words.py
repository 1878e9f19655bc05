"""A log-likelihood ratio is written in words, with its number."""

from __future__ import annotations

import pytest
from heli_lab.explain.wording import evidence_in_words


@pytest.mark.parametrize(
    ("nats", "words"),
    [
        (-0.2, "hardly any evidence (log-likelihood ratio below 1 nat)"),
        (0.9, "hardly any evidence (log-likelihood ratio below 1 nat)"),
        (2.9, "some evidence (log-likelihood ratio 3 nats)"),
        (4.9, "strong evidence (log-likelihood ratio 5 nats)"),
        (5.0, "very strong evidence (log-likelihood ratio 5 nats)"),
        (345.0, "very strong evidence (log-likelihood ratio 345 nats)"),
        (2385228.0, "very strong evidence (log-likelihood ratio above 1000 nats)"),
    ],
)
def test_evidence_has_words_and_a_number(nats: float, words: str) -> None:
    assert evidence_in_words(nats) == words

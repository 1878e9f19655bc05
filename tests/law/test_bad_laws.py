"""A law that no board can fly is refused in one line, with the remedy, before anything is sent."""

# ruff: noqa: E501  -- a row each
from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import casadi as ca
import numpy as np
import pytest
from heli_host.board.law_program import hash_of
from heli_host.errors import BadLaw
from heli_lab.law import Command, Law, control_law, from_function, from_gain, from_state_space
from heli_test_native import law as native_law


def law(function: Callable[..., Any], **options: Any) -> Law:
    made: Law = control_law(**options)(function)
    made.program  # noqa: B018  -- made when asked for
    return made


def branches(now: Any, state: Any, parameter: Any) -> Command:
    if now.elevation_rad > 0.0:
        return Command(1.0, 1.0)
    return Command(2.0, 2.0)


def of_the_wrong_shape() -> Law:
    import control

    return from_state_space(control.ss(1, 1, 1, 0), hover_V=1.4)


BAD: dict[str, tuple[Callable[[], Any], str]] = {
    "a Python if": (lambda: law(branches), "write if_else"),
    "three outputs": (lambda: law(lambda now, state, parameter: (1.0, 2.0, 3.0)), "return Command"),
    "2,000 states": (
        lambda: law(lambda n, s, p: Command(1.0, 1.0), states={f"x{k}": 0.0 for k in range(2000)}), "reduce the order",
    ),
    "333 Hz": (lambda: law(lambda n, s, p: Command(1.0, 1.0), rate_Hz=333), "give 250 or 500 Hz"),
    "math.sin": (lambda: law(lambda n, s, p: Command(math.sin(n.pitch_rad), 1.0)), "sin, cos, sqrt"),
    "an unknown function": (lambda: law(lambda n, s, p: Command(ca.erf(n.pitch_rad), 1.0)), "use only"),
    "a constant that is no number": (lambda: law(lambda n, s, p: Command(n.pitch_rad * np.inf, 1.0)), "finite"),
    "five signals": (
        lambda: law(lambda n, s, p: Command(1.0, 1.0, signals={f"s{k}": 0.0 for k in range(5)})), "at most 4",
    ),
    "a state that is not there": (lambda: law(lambda n, s, p: Command(1.0, 1.0, states={"x": 0.0})), "name it"),
    "a gain of the wrong shape": (lambda: from_gain(np.eye(3), hover_V=1.4), "give 2 x 6"),
    "a gain that is no number": (
        lambda: from_gain(np.diag([1.0, np.nan]) @ np.ones((2, 6)), hover_V=1.4),
        "the gain of differential on elevation_rad is nan",
    ),
    "gains in words": (lambda: from_gain("1 2 3", hover_V=1.4), "no array of numbers"),
    "a rate that is no number": (
        lambda: from_gain(np.ones((2, 6)), hover_V=1.4, rate_Hz=np.nan),
        "rate_Hz is nan",
    ),
    "a system of the wrong shape": (of_the_wrong_shape, "6 inputs"),
    "a function of the wrong shape": (
        lambda: from_function(ca.Function("f", [ca.SX.sym("x", 3)], [ca.SX(2, 1)])), "write it with [17",
    ),
    "a law that takes too long": (
        lambda: law(lambda n, s, p: Command(sum(ca.sqrt(n.pitch_rad + k) for k in range(200)), 1.0)), "Hz it fits",
    ),
}  # fmt: skip


@pytest.mark.medium
@pytest.mark.parametrize("name", BAD)
def test_a_bad_law_is_one_line_with_its_remedy(name: str) -> None:
    make, remedy = BAD[name]
    with pytest.raises(BadLaw) as caught:
        make()
    assert "\n" not in str(caught.value)
    assert remedy in str(caught.value)
    assert caught.value.remedy


@pytest.mark.medium
def test_any_words_above_a_valid_hash_are_refused_or_run_within_the_tape() -> None:
    chance = np.random.default_rng(5)
    good = np.array(law(lambda n, s, p: Command(n.pitch_rad * s.x + p.k, ca.atan2(n.travel_rad, 2.0), states={"x": n.front_V}), states={"x": 1.0}, parameters={"k": 2.0}).program.words, np.uint32)  # fmt: skip
    tape, accepted = native_law.Tape(), 0
    inputs = chance.normal(size=(3, 17)).astype(np.float32)
    for _ in range(20_000):
        words = good.copy()
        for _ in range(int(chance.integers(1, 4))):
            words[chance.integers(len(words))] ^= np.uint32(1 << int(chance.integers(32)))
        words = words[: len(words) - int(chance.integers(0, 2))]
        error, _, ticks = tape.load(words.tolist(), hash_of(words.tolist()))
        if error == 0:
            accepted += 1
            assert 1 <= ticks <= 16
            tape.run(inputs)
    assert 100 < accepted < 19_000


@pytest.mark.medium
def test_an_upload_that_ends_anywhere_leaves_no_law() -> None:
    words = law(lambda n, s, p: Command(n.pitch_rad + 1.0, 1.0)).program.words
    for length in range(len(words)):
        tape = native_law.Tape()
        assert tape.load(words[:length], hash_of(words))[0] != 0
        with pytest.raises(ValueError, match="no law"):
            tape.restart()

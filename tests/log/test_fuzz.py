"""Damaged logs are refused in a line, or read."""

from __future__ import annotations

import pytest

from tests.log.fuzz_log import fuzz_log
from tests.running.long import samples

pytestmark = pytest.mark.medium


def test_no_damage_to_a_log_raises_anything_but_an_error_of_one_line() -> None:
    broken = fuzz_log(2, samples(4000, 200))
    assert not broken, broken.most_common(5)

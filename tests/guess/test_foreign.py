"""Raw files as other repositories write them need few corrections, and a doubt names each of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.guess.foreign import write
from tests.guess.grade import DEVELOPMENT_SEEDS, grade
from tests.running.long import samples


@pytest.mark.slow
@pytest.mark.parametrize("seed", DEVELOPMENT_SEEDS[1 :: samples(1, 9)])
def test_a_raw_file_needs_at_most_one_correction_and_a_doubt_names_it(seed: int, tmp_path: Path) -> None:
    graded = grade(write(seed, tmp_path))
    assert graded.corrections <= 1, graded
    assert not graded.silent, graded
    assert not (graded.sure and graded.wrong), graded

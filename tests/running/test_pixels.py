"""A picture with a curve has coloured pixels, and one with empty axes has none."""

from __future__ import annotations

from pathlib import Path

import pytest
from matplotlib.figure import Figure

from tests.running.pixels import coloured_share


@pytest.mark.medium
def test_only_a_curve_has_colour(tmp_path: Path) -> None:
    figure = Figure()
    axes = figure.subplots()
    axes.set_title("Empty")
    axes.grid(True)
    figure.savefig(tmp_path / "empty.png")
    assert coloured_share(tmp_path / "empty.png") == 0.0
    axes.plot([0.0, 1.0, 0.5])
    figure.savefig(tmp_path / "curve.png")
    assert coloured_share(tmp_path / "curve.png") > 0.001

"""Figures are the same in either process, and none is lost when the drawing process dies."""

from __future__ import annotations

import base64
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from heli_lab.report.page import drawing
from heli_lab.report.page.drawing import Drawing, png_of
from matplotlib.figure import Figure


def figure(number: int, points: int = 2) -> Figure:
    """Draw a small figure that differs by its number."""
    drawn = Figure(figsize=(2, 1))
    drawn.subplots().plot([number] * points, label="$x^2$")
    return drawn


@pytest.mark.medium
def test_a_second_process_draws_the_same_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = [png_of(figure(number)) for number in range(3)]
    with Drawing(use_process=True) as drawing_process:
        added = [drawing_process.add(figure(number), tmp_path / f"{number}.png") for number in range(3)]
        # None of them is drawn here.
        monkeypatch.setattr(drawing, "png_of", lambda _: pytest.fail("drawn here"))
        while drawing_process.waiting:
            time.sleep(0.01)
        addresses = [str(picture) for picture in added]
    assert [(tmp_path / f"{number}.png").read_bytes() for number in range(3)] == expected
    assert [base64.b64decode(address.partition(",")[2]) for address in addresses] == expected


@pytest.mark.skipif(sys.platform == "win32", reason="ended by a signal")
def test_pictures_of_a_killed_process_are_drawn_in_this_process(tmp_path: Path) -> None:
    with Drawing(use_process=True) as drawing_process:
        first = drawing_process.add(figure(1), tmp_path / "1.png")
        while drawing_process.process is None:
            time.sleep(0.01)
        os.kill(drawing_process.process.pid, signal.SIGKILL)
        # More than a pipe holds.
        second = drawing_process.add(figure(2, 100_000), tmp_path / "2.png")
        assert str(second)
        assert str(first)
    assert (tmp_path / "1.png").read_bytes() == png_of(figure(1))
    assert (tmp_path / "2.png").read_bytes() == png_of(figure(2, 100_000))


def test_without_a_process_all_pictures_are_drawn_in_this_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: pytest.fail("a process was started"))
    assert base64.b64decode(str(Drawing().add(figure(4), tmp_path / "4.png")).partition(",")[2]) == png_of(
        figure(4)
    )


def test_all_pictures_are_drawn_if_the_process_does_not_start(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "executable", str(tmp_path / "no python"))
    with Drawing(use_process=True) as drawing_process:
        assert str(drawing_process.add(figure(5), tmp_path / "5.png"))


def test_drawing_process_ends_after_an_exception() -> None:
    with pytest.raises(KeyError), Drawing(use_process=True) as drawing_process:
        while drawing_process.process is None:
            time.sleep(0.01)
        raise KeyError
    assert drawing_process.process is not None
    assert drawing_process.process.poll() is not None


def test_a_picture_that_cannot_be_written_is_an_error_and_no_empty_picture(tmp_path: Path) -> None:
    with Drawing(use_process=True) as drawing_process:
        picture = drawing_process.add(figure(6), tmp_path / "no folder" / "6.png")
        while drawing_process.waiting:
            time.sleep(0.01)
        with pytest.raises(FileNotFoundError):
            _ = str(picture)

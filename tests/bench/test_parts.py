"""The bench measures what it is asked to, and goes on where something is not installed."""

import io
from dataclasses import replace

import pytest
from rich.console import Console

from tests.bench.__main__ import PARTS, Part, main, measured_by, module, table
from tests.bench.result import PROMISES, Measured


def test_a_part_without_its_package_is_skipped_in_one_line_and_the_next_is_measured() -> None:
    output = io.StringIO()
    first = Part(
        "first", "what cannot be", 5, lambda _: [Measured("never", [1.0])], module("no_such_package")
    )
    second = replace(first, name="second", measure=lambda _: [Measured("there", [2.0])], lack=lambda: "")
    measured, failed = measured_by([first, second], Console(file=output, width=100))
    assert [row.key for row in measured] == ["there"] and not failed
    assert output.getvalue().splitlines()[1] == (
        "      skipped: no_such_package is not installed; make bench does that"
    )


def test_a_part_that_fails_does_not_lose_the_others() -> None:
    def fails(_: object) -> list[Measured]:
        raise RuntimeError("no space")

    first = Part("first", "what fails", 5, fails)
    second = replace(first, name="second", measure=lambda _: [Measured("there", [2.0])])
    output = io.StringIO()
    measured, failed = measured_by([first, second], Console(file=output, width=100))
    assert [row.key for row in measured] == ["there"] and failed == ["first"]
    assert "RuntimeError: no space" in output.getvalue()


def test_a_part_that_is_not_known_is_refused_in_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        main(["growht"])
    assert stopped.value.code == 2
    assert "no part is called growht; there are simulation, " in capsys.readouterr().err


def test_a_promise_that_is_missed_fails_and_one_that_was_not_asked_for_has_no_row() -> None:
    promise = next(candidate for candidate in PROMISES if candidate.bound is not None and candidate.at_least)
    assert promise.bound is not None
    for value, holds in ((promise.bound, True), (0.9 * promise.bound, False)):
        report, all_hold = table([Measured(promise.key, [value])], whole=False)
        assert (all_hold, report.row_count) == (holds, 1)
    report, _ = table([], whole=True)
    assert report.row_count == len(PROMISES)


def test_each_part_has_a_name_of_its_own() -> None:
    assert len({part.name for part in PARTS}) == len(PARTS)

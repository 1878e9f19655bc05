"""The table of faults in docs/reference/failures.md is what a run of it gives."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from heli_host.declaration import State

from tests.firmware.built import built_elf
from tests.fly.fault_flights import Case, Outcome, flown
from tests.fly.fault_table import CASES, ELSEWHERE, HEAD, row
from tests.running.long import LONG, select_cases

pytest.importorskip("heli_sim._native", reason="skipped: the simulation is not built")

DOCUMENT = Path("docs/reference/failures.md")
TESTS = Path(__file__).parent
NATIVE = select_cases([case for case in CASES if not case.due_only], every=3)
# Flown on the emulated Due in `make test`: what only it has, and one of each kind of the others.
KINDS = ("the travel encoder is out from the start", "the board loses its power", "SIGTERM")
EMULATED = [case for case in CASES if case.due_only or LONG or case.what in KINDS]
NUMBER = re.compile(r"\d+(?:\.\d+)?")


def document() -> list[str]:
    """Rows of the table."""
    lines = DOCUMENT.read_text(encoding="utf-8").splitlines()
    begin = lines.index(HEAD) + 2
    end = next(k for k in range(begin, len(lines)) if not lines[k].startswith("|"))
    return lines[begin:end]


def assert_agrees_with_document(case: Case, outcome: Outcome) -> None:
    """The document's row has the same words, and numbers within a tenth of a second or 2 %."""
    [document_row] = [line for line in document() if line.startswith(f"| {case.what} |")]
    flown_row = row(case, outcome)
    assert NUMBER.sub("#", document_row) == NUMBER.sub("#", flown_row)
    for written, measured in zip(NUMBER.findall(document_row), NUMBER.findall(flown_row), strict=True):
        near_s = 0.1 if float(measured) > 1.0 else 0.02
        assert float(written) == pytest.approx(float(measured), rel=0.02, abs=near_s), flown_row


def assert_handled(case: Case, outcome: Outcome) -> None:
    assert outcome.acted_s <= case.within_s
    assert case.says in outcome.says
    assert outcome.volts_V == [0.0, 0.0]
    # Latched: nothing turns again before it is cleared.
    assert not case.says.startswith("fault") or outcome.state == State.FAULT


def test_every_row_of_the_table_is_shown_by_a_flight_or_a_test() -> None:
    first_cells = [line.split(" | ")[0].removeprefix("| ") for line in document()]
    assert first_cells == [case.what for case in CASES] + list(ELSEWHERE)
    tests = "".join(path.read_text(encoding="utf-8") for path in TESTS.glob("test_*.py"))
    for name in ELSEWHERE.values():
        assert f"def {name}(" in tests


@pytest.mark.slow
@pytest.mark.parametrize("case", NATIVE, ids=lambda case: str(case.what))
def test_a_fault_is_handled_as_the_table_says(case: Case) -> None:
    outcome = flown(case)
    assert_handled(case, outcome)
    assert_agrees_with_document(case, outcome)


@pytest.mark.emulated
@pytest.mark.parametrize("case", EMULATED, ids=lambda case: str(case.what))
def test_a_fault_is_handled_by_the_emulated_due_as_the_table_says(case: Case) -> None:
    outcome = flown(case, "due", str(built_elf()))
    assert_handled(case, outcome)
    assert_agrees_with_document(case, outcome)


def test_without_a_cable_the_board_does_what_it_does_without_a_host() -> None:
    off_s = {line.split(" | ")[0]: line.partition("motors off after ")[2] for line in document()}
    off_text = off_s["| the host is killed (`kill -9`)"].partition(" |")[0]
    for case in CASES:
        if case.as_if is not None:
            assert off_s[f"| {case.what}"].partition(" |")[0] == off_text

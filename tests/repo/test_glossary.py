"""Each word of docs/reference/glossary.md leads to the code that it names."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "reference" / "glossary.md").read_text()
PACKAGES = {"heli_host": "host", "heli_sim": "sim", "heli_lab": "sim", "heli_benchmark": "sim"}
CELLS = [
    [cell.strip() for cell in line.split("|")[1:-1]] for line in TEXT.splitlines() if line.startswith("| ")
]
ROWS = {cells[0]: (cells[3], cells[4]) for cells in CELLS if len(cells) == 5 and cells[0] != "term"}
REFERENCES = set(re.findall(r"^- \[([^]]+)\]", TEXT, re.MULTILINE))


@pytest.mark.parametrize("term", ROWS)
def test_term_leads_to_the_code_and_to_a_reference(term: str) -> None:
    where, references = ROWS[term]
    path, _, name = where.strip("`").partition(":")
    package = path.partition("/")[0]
    file = ROOT / PACKAGES[package] / path if package in PACKAGES else ROOT / path
    assert file.is_file(), f"{term}: there is no {path}"
    defined = rf"^(?:class|def) {name}\b|^{name}(?::| =)"
    assert not name or re.search(defined, file.read_text(), re.MULTILINE), f"{term}: {path} defines no {name}"
    assert set(re.findall(r"\[([^]]+)\]", references)) <= REFERENCES


@pytest.mark.parametrize(
    "term",
    ["Kalman filter", "innovations", "score test", "Schur complement", "quantisation", "whiteness test"],
)
def test_the_field_s_word_is_there(term: str) -> None:
    assert term in ROWS

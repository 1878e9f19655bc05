"""The table of thresholds is complete, and no threshold is set on cases that judge the project."""

from __future__ import annotations

import re
from pathlib import Path

from heli_lab.explain import thresholds


def test_every_threshold_has_a_unit_and_a_source_in_the_table() -> None:
    constants = {name for name in vars(thresholds) if re.match(r"[A-Z]\w+_|[A-Z]{2}", name)}
    constants -= {source.name for source in thresholds.Source}
    rows = {row.name: row for row in thresholds.table()}
    assert set(rows) == constants
    assert all(row.unit for row in rows.values())
    assert rows["CALIBRATE_s"] == thresholds.Threshold("CALIBRATE_s", "s", 8.0, thresholds.JUDGEMENT)


def test_units_at_the_end_of_names_are_those_of_the_table() -> None:
    for row in thresholds.table():
        if (suffix := row.name.rpartition("_")[2]) in ("s", "NATS"):
            assert row.unit == suffix.lower(), row.name


def test_no_constant_of_a_diagnosis_cites_a_case_that_judges() -> None:
    package = Path(thresholds.__file__).parent
    assert not [path.name for path in package.rglob("*.py") if "blind" in path.read_text(encoding="utf-8")]

"""Imported flights get names of their own, and replace only flights of the same source."""

from pathlib import Path

import numpy as np
import pytest
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.data.log.table import write_csv
from heli_host.data.tables import Column, Table
from heli_host.errors import FlightDataError
from heli_lab.setup.guess import merge_tables
from heli_lab.setup.guess.files import Target, digest, entry_lines, output_names

FLIGHT = Flight(np.arange(20.0, dtype=np.float64) * 0.01, *np.zeros((5, 20)))


def test_files_of_one_name_are_named_by_their_folders_too() -> None:
    paths = [Path("a/x.mat"), Path("b/x.mat"), Path("b/u.csv.gz")]
    assert output_names(paths) == ["a-x", "b-x", "u"]


@pytest.mark.parametrize(
    ("paths", "reason"),
    [
        (("a/x.mat", "a/../a/x.mat"), "is given twice"),
        (("a/x.mat", "a/x.csv"), "would both be written to a-x.csv"),
        (("a/b/x.mat", "c/b/x.mat"), "would both be written to b-x.csv"),
    ],
)
def test_no_flight_of_one_import_replaces_another(paths: tuple[str, str], reason: str) -> None:
    with pytest.raises(FlightDataError, match=reason) as refused:
        output_names([Path(path) for path in paths])
    assert refused.value.remedy


def test_a_flight_of_another_source_is_not_replaced(tmp_path: Path) -> None:
    for name, content in (("a", "1"), ("b", "2")):
        (tmp_path / name).mkdir()
        (tmp_path / name / "x.mat").write_text(content)
    mine, other = (Target(tmp_path, "x", digest([tmp_path / name / "x.mat"])) for name in ("a", "b"))
    mine.refuse_to_replace_another()
    write_csv(mine.with_digest(FLIGHT), mine.path(None))
    mine.refuse_to_replace_another()
    with pytest.raises(FlightDataError, match=r"x.csv was imported from another file"):
        other.refuse_to_replace_another()


def test_each_entry_has_its_line_or_that_of_its_section() -> None:
    lines = entry_lines('# sign = 7\nmirrored = false\n\n[pitch]\ncolumn = "p"\nsign = 1\n')
    assert (lines["mirrored"], lines["pitch.sign"], lines["pitch.delay_s"]) == (2, 6, 4)


def test_files_of_equal_length_are_merged_row_by_row_and_the_notes_state_it() -> None:
    t_s: Floats = np.arange(50, dtype=np.float64) * 0.01
    x = Table("a/x.mat", {"t": Column(t_s, "s"), "p": Column(np.sin(t_s))})
    u = Table("a/u.mat", {"f": Column(np.cos(9.0 * t_s))})
    merged = merge_tables([x, u])
    assert list(merged.columns) == ["1: p", "2: f"]
    assert merged.columns["2: f"].t_s == pytest.approx(t_s)
    assert merged.notes == "u.mat was merged row by row with x.mat"
    with pytest.raises(FlightDataError, match=r"u.mat: it has no times, and no other .* its 40 rows"):
        merge_tables([x, Table("a/u.mat", {"f": Column(np.cos(9.0 * t_s[:40]))})])

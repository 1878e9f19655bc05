"""The command that calibrates two thresholds uses development seeds, and counts true names alone as true."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.diagnose.calibration import cases, main, measure, names_in_unexplained


def test_calibration_seeds_are_distinct_and_in_their_range() -> None:
    seeds = [case.seed for case in cases().values()]
    assert len(set(seeds)) == len(seeds)
    assert all(6000 <= seed < 6500 for seed in seeds)


def test_share_of_true_names_counts_unexplained_diagnoses_only() -> None:
    first, second, third = list(cases())[:3]
    (listed, lacking) = cases()[first].hidden
    assert cases()[first].removed == lacking
    rows = {
        first: {"verdict": "unexplained", "causes": [listed, "flywheel"]},
        second: {"verdict": "cause_found", "causes": ["flywheel"]},
        third: {"verdict": "unexplained", "causes": []},
    }
    true_names, all_names = names_in_unexplained(rows)
    assert (true_names, all_names) == (1, 2)


def test_calibration_continues_from_its_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    name = next(iter(cases()))
    path = tmp_path / "rows.jsonl"
    path.write_text(f'["{name}", {{"verdict": "ambiguous", "causes": [], "correlation_time_s": null}}]\n')
    assert dict(measure(path, [name]))[name]["verdict"] == "ambiguous"
    assert main([name, "-o", str(path)]) == 0
    assert "0 of 0 are true" in capsys.readouterr().out

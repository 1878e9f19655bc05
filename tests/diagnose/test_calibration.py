"""The command that calibrates two thresholds uses development seeds, and counts true names alone as true."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
from heli_lab.explain import thresholds
from heli_lab.explain.verdict import unconfirmed_confidence

from tests.diagnose import calibration, confidence, sensitivity
from tests.diagnose.calibration import cases, measure, names_in_unexplained
from tests.diagnose.confidence import DEVELOPMENT, FRESH, JUDGING, KINDS, case, is_right
from tests.diagnose.sensitivity import CASES, in_a_process, judged, scaled


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
    assert calibration.main([name, "-o", str(path)]) == 0
    assert "0 of 0 are true" in capsys.readouterr().out


LEVELS = np.linspace(0.01, 0.99, 99)


def test_confidence_without_confirmation_is_lower_and_grows_with_evidence() -> None:
    lowered = np.array([unconfirmed_confidence(level) for level in LEVELS])
    assert np.all(np.diff(lowered) >= 0.0)
    assert np.all(lowered <= LEVELS)
    assert 0.8 < lowered[-1] < 0.9
    # Two of the first seven causes from 0.7 to 0.95 were right.
    assert np.all(lowered[(LEVELS > 0.7) & (LEVELS < 0.945)] < 0.75)
    assert lowered[0] > 0.0


def test_kinds_of_cases_alternate_and_an_event_has_a_moment_in_flight() -> None:
    drawn_cases = [case(seed) for seed in JUDGING]
    assert {drawn.kind for drawn in drawn_cases} == set(KINDS)
    for drawn in drawn_cases:
        assert bool(drawn.removed) == ("lacking" in drawn.kind)
        assert drawn.removed in ("", *drawn.hidden)
        for values in drawn.hidden.values():
            assert all(8.0 <= value <= 12.0 for name, value in values.items() if name.endswith("_at_s"))


def test_no_seed_of_the_calibration_judges_it() -> None:
    assert not {*DEVELOPMENT, *FRESH} & {*JUDGING}


def test_only_a_hidden_effect_or_one_of_two_is_right() -> None:
    drawn = next(drawn for drawn in map(case, JUDGING) if drawn.kind == "one")
    (hidden,) = drawn.hidden
    assert is_right(drawn, hidden, ())
    assert is_right(drawn, "flywheel", (hidden,))
    assert not is_right(drawn, "flywheel", ())
    assert not is_right(drawn, "flywheel", (hidden, "axis_tilt"))


@pytest.mark.medium
def test_measurement_continues_from_its_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    cause = {"effect": "flywheel", "ambiguous_with": [], "verdict": "cause_found", "confirmed": False}
    cause |= {"why_not": "it happened in one flight only", "if_confirmed": 0.9, "confidence": 0.6}
    path = tmp_path / "rows.jsonl"
    path.write_text(json.dumps([9305, {"forward": [cause]}]) + "\n")
    assert confidence.main(["9305", "-o", str(path)]) == 0
    assert "0.50 to 0.70: mean 0.60, 0 of 1 right" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("value", "factor", "expected"),
    [
        (3, 0.5, 1),
        (1, 0.5, 1),
        (3, 2.0, 6),
        (0.8, 2.0, 1.0),
        (6.0, 2.0, 12.0),
        ((0.2, 5.0), 2.0, (0.1, 10.0)),
    ],
)
def test_a_constant_is_halved_or_doubled_as_its_type_allows(
    value: object, factor: float, expected: object
) -> None:
    assert scaled(value, factor) == expected


@pytest.mark.diagnosis
def test_a_shortlist_of_one_effect_changes_the_answer_on_a_small_lag() -> None:
    from heli_lab.explain import thresholds

    answer = in_a_process({"SHORTLIST": 0.5}, ["small lag"])
    assert answer["small lag"] != ["ambiguous", "rotor_lag"]
    assert answer["small lag"][0] != "failed"
    assert thresholds.SHORTLIST == 3


def test_only_constants_of_judgement_are_accepted(capsys: pytest.CaptureFixture[str]) -> None:
    assert "SHORTLIST" in dict(judged())
    assert "FALSE_DISCOVERY_RATE" not in dict(judged())
    with pytest.raises(SystemExit):
        sensitivity.main(["FALSE_DISCOVERY_RATE"])
    assert "FALSE_DISCOVERY_RATE" in capsys.readouterr().err
    assert "small lag" in CASES


def test_every_threshold_has_a_unit_and_a_source_in_the_table() -> None:
    constants = {name for name in vars(thresholds) if re.match(r"[A-Z]\w+_|[A-Z]{2}", name)}
    constants -= {source.name for source in thresholds.Source}
    rows = {row.name: row for row in thresholds.table()}
    assert set(rows) == constants
    assert all(row.unit for row in rows.values())
    assert rows["CALIBRATE_s"] == thresholds.Threshold(
        "CALIBRATE_s", unit="s", value=8.0, source=thresholds.JUDGEMENT
    )


def test_units_at_the_end_of_names_are_those_of_the_table() -> None:
    for row in thresholds.table():
        if (suffix := row.name.rpartition("_")[2]) in ("s", "NATS"):
            assert row.unit == suffix.lower(), row.name


def test_no_constant_of_a_diagnosis_cites_a_case_that_judges() -> None:
    package = Path(thresholds.__file__).parent
    assert not [path.name for path in package.rglob("*.py") if "blind" in path.read_text(encoding="utf-8")]

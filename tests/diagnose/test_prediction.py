"""Another flight of a rig: its zeros and torques from its beginning, its rest predicted at three horizons."""

import json
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Final

import numpy as np
import pytest
from heli_host.data.flight import Flight
from heli_host.data.log.table import write_csv
from heli_lab.diagnose import Diagnosis, to_json
from heli_lab.errors import IdentifyError
from heli_lab.explain import replication
from heli_lab.explain.comparison import split, two_folds
from heli_lab.explain.prediction import (
    HORIZONS,
    ErrorReduction,
    FreeRun,
    WindowErrors,
    calibration_s,
    error_reduction,
    extrapolations,
    free_run,
)
from heli_lab.explain.replication import Replication, replicate
from heli_lab.explain.stepwise import Direction
from heli_lab.explain.verdict import unconfirmed_confidence
from heli_lab.fit.records import Record, prepare
from heli_lab.report.diagnosis.text import lines
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import parse_effects
from heli_sim.rig import Rig, load_rig

from tests.cli.terminal import Terminal
from tests.diagnose.hidden import MADE_BY, flights
from tests.diagnose.test_causes import diagnosed
from tests.identify.made import flown, thinned
from tests.running.kept import FLOWN, KEPT

pytestmark = pytest.mark.diagnosis

TODAY: Final = {"torque_pitch": 0.008, "torque_travel": 0.03}
"""Torques of cables on the day of the flight, N m."""
ZEROS_deg: Final = {"offset_elevation": 0.7, "offset_pitch": -0.4}
"""Where the encoders were zeroed on it."""
LAG_s: Final = 0.06


def the_rig() -> Rig:
    """Return the rig as other flights have identified it; its encoder zeros are uncertain by 1 degree."""
    rig = load_rig("makki2024").replace(thrust_gain=0.62, friction_travel=0.05)
    numbers = dict(rig.numbers)
    for name in ZEROS_deg:
        numbers[name] = replace(numbers[name], tolerance=2.0)
    return replace(rig, numbers=numbers)


def _flown() -> Flight:
    """Fly the rig with a lag and the torques of that day."""
    lag = MultibodyModel(parse_effects([f"rotor_lag={LAG_s}"]))
    return thinned(flown(the_rig().replace(**TODAY), 14, 26.0, lag), 2)


@cache
def that_day() -> Record:
    """Return a flight with a lag, on a day with other cable torques and encoder zeros."""
    made_by = (*MADE_BY, Path(__file__))
    record = prepare(KEPT("another day", _flown, made_by=made_by, rooms=FLOWN), the_rig(), "that day")
    return replace(record, angles_rad=record.angles_rad + np.deg2rad([*ZEROS_deg.values(), 0.0]))


@cache
def predicted(*effects: str, calibrate_s: float = 8.0) -> FreeRun:
    """Predict the flight with these effects."""
    return free_run(MultibodyModel(parse_effects(effects)), the_rig(), {}, that_day(), calibrate_s)


RIGHT: Final = f"rotor_lag={LAG_s}"


def test_calibration_finds_zeros_and_torques_of_the_day() -> None:
    constants = predicted(RIGHT).constants
    assert constants.keys() == {"torque_elevation", *TODAY, *ZEROS_deg}
    for name, truth in {**TODAY, **ZEROS_deg}.items():
        value, std = constants[name]
        # The board zeroes an encoder in whole counts, so each flight has an unknown part of a count.
        slack = 0.09 if name in ZEROS_deg else 0.0
        assert abs(value - truth) < 3.0 * std + slack, name
    torque_Nm, std_Nm = constants["torque_pitch"]
    assert abs(torque_Nm) > 10.0 * std_Nm


def test_calibrated_prediction_has_errors_of_quantisation_only() -> None:
    quantisation_deg = np.rad2deg(that_day().sigma_rad)
    for key in HORIZONS:
        assert np.all(predicted(RIGHT).errors[key].rms_deg < 1.05 * quantisation_deg)
    uncalibrated = predicted(RIGHT, calibrate_s=0.0)
    assert uncalibrated.constants == {}
    assert uncalibrated.errors["2"].rms_deg[1] > 5.0 * quantisation_deg[1]


def test_errors_by_a_missing_lag_grow_with_the_horizon() -> None:
    pitch_deg = [predicted().errors[key].rms_deg[1] for key in ("0.5", "1", "2")]
    right_deg = [predicted(RIGHT).errors[key].rms_deg[1] for key in ("0.5", "1", "2")]
    assert pitch_deg == sorted(pitch_deg)
    assert all(wrong > 2.0 * right for wrong, right in zip(pitch_deg, right_deg, strict=True))


def test_horizons_are_judged_on_the_same_samples_after_the_beginning() -> None:
    run, record = predicted(RIGHT), that_day()
    rows = [run.errors[key].rows for key in HORIZONS]
    assert all(np.array_equal(rows[0], other) for other in rows)
    assert rows[0].sum() * record.step_s == pytest.approx(run.evaluated_s, abs=0.1)
    assert run.calibrated_s == pytest.approx(8.0, abs=0.01)
    assert run.calibrated_s + run.evaluated_s == pytest.approx(record.used_s)
    problem = run.fit.problem
    first_evaluated_row = problem.grid(0, True, run.fit.theta).rows[0]
    first_evaluated_s = problem.records[0].t_s[first_evaluated_row]
    begin_s = record.t_s[record.segments[0][0]]
    assert first_evaluated_s == pytest.approx(begin_s + 8.0, abs=0.01)


def _swinging(record: Record, rows: slice) -> Record:
    """Let pitch swing by 1 degree in some rows, which no model explains."""
    angles = record.angles_rad.copy()
    angles[rows, 1] += np.deg2rad(1.0) * np.sin(5.0 * record.t_s[rows])
    return replace(record, angles_rad=angles)


def test_evaluated_part_has_no_influence_on_the_calibration() -> None:
    record = that_day()
    model = MultibodyModel(parse_effects([RIGHT]))
    # The first 8 s calibrate; the rest is evaluated.
    (first_row, _), *_ = record.segments
    first_evaluated = first_row + round(8.0 / record.step_s)
    swings_later = free_run(model, the_rig(), {}, _swinging(record, slice(first_evaluated, None)))
    assert swings_later.constants == predicted(RIGHT).constants
    _, pitch_rms_deg, _ = swings_later.errors["2"].rms_deg
    assert pitch_rms_deg > 0.3
    swings_earlier = free_run(model, the_rig(), {}, _swinging(record, slice(0, first_evaluated)))
    assert swings_earlier.constants != predicted(RIGHT).constants


def test_values_found_on_other_flights_are_the_means_of_the_priors() -> None:
    values = {"rotor_lag_s": LAG_s, "torque_pitch": 0.008, "offset_elevation": 0.5}
    run = free_run(MultibodyModel(parse_effects(["rotor_lag=0.02"])), the_rig(), values, that_day())
    assert run.priors["torque_pitch"].mean == 0.008
    assert run.priors["offset_elevation"].mean == 0.5
    assert run.errors["2"].rms_deg[1] == pytest.approx(predicted(RIGHT).errors["2"].rms_deg[1], rel=0.02)


def _cut(record: Record, seconds: float) -> Record:
    """Keep the first seconds of free flight."""
    start = record.segments[0][0]
    return replace(record, segments=((start, start + round(seconds / record.step_s)),))


def test_two_thirds_of_a_flight_are_judged_however_short_it_is() -> None:
    record = that_day()
    assert calibration_s(record) == 8.0
    assert calibration_s(record, 3.0) == 3.0
    assert calibration_s(record, 0.0) == 0.0
    assert calibration_s(_cut(record, 12.0)) == pytest.approx(4.0)
    assert calibration_s(_cut(record, 12.0), 8.0) == pytest.approx(4.0)
    assert calibration_s(_cut(record, 1.5)) == pytest.approx(0.5)


@pytest.mark.parametrize(
    ("asked_s", "message"),
    [
        (-1.0, r"-1 s of calibration is not possible; give --calibrate 0 or more"),
        (float("nan"), "give --calibrate 0 or more"),
        (12.0, r"leave no time of the 12 s of free flight in that day; give 4 or less to --calibrate"),
    ],
)
def test_too_long_calibration_is_refused_with_the_longest_possible(asked_s: float, message: str) -> None:
    with pytest.raises(IdentifyError, match=message):
        calibration_s(_cut(that_day(), 12.0), asked_s)


def test_flight_in_pieces_is_calibrated_on_its_first_seconds_of_free_flight() -> None:
    record = that_day()
    start, stop = record.segments[0]
    piece = [round(at / record.step_s) for at in (3.0, 5.0, 8.0, 20.0)]
    segments = ((start, start + piece[0]), (start + piece[1], start + piece[2]), (start + piece[3], stop))
    run = free_run(
        MultibodyModel(parse_effects([RIGHT])), the_rig(), {}, replace(record, segments=segments), 5.0
    )
    assert run.calibrated_s == pytest.approx(5.0)
    # The cut leaves one second of the second piece, which is judged with the third.
    assert run.fit.problem.records[0].segments == (
        (start + piece[1] + round(2.0 / record.step_s), start + piece[2]),
        (start + piece[3], stop),
    )


def test_interval_is_narrow_only_if_all_windows_show_the_error_reduction() -> None:
    rows, equal_errors = np.full(12, 1000.0), np.ones((12, 3))
    quarter_errors = 0.25 * equal_errors
    in_all_windows = error_reduction(
        [WindowErrors(equal_errors, rows)], [WindowErrors(quarter_errors, rows)]
    )["pitch"]
    assert in_all_windows.interval95 == pytest.approx((in_all_windows.ratio, in_all_windows.ratio))
    # A bootstrap sample without the first window has no reduction at all.
    one_large_error = equal_errors.copy()
    one_large_error[0] = 100.0
    in_one_window = error_reduction(
        [WindowErrors(one_large_error, rows)], [WindowErrors(equal_errors, rows)]
    )["pitch"]
    assert in_one_window.ratio < in_all_windows.ratio
    assert in_one_window.interval95[1] == pytest.approx(1.0)


def judged(
    monkeypatch: pytest.MonkeyPatch, diagnosis: Diagnosis, nats: float, worst: tuple[float, float]
) -> Replication:
    """Judge a lag again whose reverse direction has this log-likelihood ratio and interval of pitch."""
    records = (
        diagnosis.assessment.after.fit.problem.records,
        diagnosis.held_out.extension.after[0].fit.problem.records,
    )
    comparison: Any = SimpleNamespace(
        train=records[0],
        held_out=records[1],
        seed=0,
        held_out_estimate=lambda _final: None,
        exchanged=lambda: None,
    )
    final = diagnosis.search.final
    back = Direction(comparison, diagnosis.search.baseline, final, {"rotor_lag": nats})
    monkeypatch.setattr(replication, "direction", lambda *_: back)

    def reductions(_judge: object, _ids: object, reverse: bool) -> dict[str, ErrorReduction]:
        ratio = float(np.mean(worst)) if reverse else 0.1
        return {"pitch": ErrorReduction(1.0, ratio, worst if reverse else (0.05, 0.2))}

    monkeypatch.setattr(replication._CauseSubsets, "reductions", reductions)
    return replicate(comparison, diagnosis.search, diagnosis.assessment, diagnosis.held_out)


def test_lag_that_both_flights_show_is_confirmed_and_in_the_rig() -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    cause = diagnosis.replication.causes["rotor_lag"]
    assert cause.confirmed
    assert cause.forward is not None and cause.reverse is not None
    # The flights are alike but for their length, and so is the evidence.
    assert cause.reverse == pytest.approx(cause.forward, rel=0.6)
    assert min(cause.forward, cause.reverse) > 20.0
    assert diagnosis.replication.worse == ()
    assert diagnosis.replication.model is diagnosis.assessment.extended
    assert "rotor_lag" in diagnosis.rig("extended").effects
    assert to_json(diagnosis)["causes"][0]["confirmed"] is True


@pytest.mark.parametrize(
    ("nats", "interval", "why"),
    [
        (-1.0, (0.1, 0.3), "less likely (log-likelihood ratio -1.0 nats)"),
        (50.0, (1.1, 1.5), "its error at 1 s is 1.30 times as large (1.10 to 1.50)"),
    ],
    ids=["likelihood", "open-loop error"],
)
def test_cause_that_fails_in_reverse_enters_the_rig_on_request_only(
    monkeypatch: pytest.MonkeyPatch, nats: float, interval: tuple[float, float], why: str
) -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    refuted = replace(diagnosis, replication=judged(monkeypatch, diagnosis, nats, interval))
    assert not refuted.replication.causes["rotor_lag"].confirmed
    assert refuted.rig("extended").effects == {}
    assert "rotor_lag" in refuted.rig("extended", with_unconfirmed=True).effects
    # The gain is that of the rig that is written: nothing was added to the baseline.
    assert all(reduction.ratio == 1.0 for reduction in refuted.error_reductions.values())
    (cause,) = to_json(refuted)["causes"]
    assert cause["confirmed"] is False
    assert why in cause["replication"]["why_not"]
    printed = "\n".join(lines(refuted))
    assert f"not confirmed: {cause['replication']['why_not']}" in printed
    # Name and verdict stay; the confidence is lower, and the same on the terminal and in the JSON.
    assert (refuted.label, cause["effect"]) == (diagnosis.label, diagnosis.verdict.causes[0].effect)
    lowered = unconfirmed_confidence(diagnosis.verdict.causes[0].confidence)
    assert cause["confidence"] == round(lowered, 3) < diagnosis.verdict.causes[0].confidence
    assert f"(confidence {cause['confidence']:.2f}; not confirmed" in printed
    assert ("predicts pitch of" in printed) == (interval[0] > 1.0)


def test_worse_prediction_within_its_interval_does_not_refute_a_cause(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    assert judged(monkeypatch, diagnosis, 50.0, (0.9, 1.5)).causes["rotor_lag"].confirmed


def test_nothing_is_confirmed_and_saved_without_a_held_out_flight(terminal: Terminal, tmp_path: Path) -> None:
    # Both halves of the flight show the lag clearly.
    fit, _ = flights("rotor_lag=0.06", seconds=(26.0, 14.0))
    write_csv(fit, tmp_path / "a.csv")
    result = terminal("diagnose", "a.csv", "--json", "a.json", "--save-rig", "a.toml")
    assert result.code == 0, result.err
    (cause,) = json.loads(Path("a.json").read_text())["causes"]
    ratios = cause["replication"]["log_likelihood_ratio"]
    assert cause["effect"] == "rotor_lag" and min(ratios.values()) > 20.0
    assert cause["confirmed"] is False and cause["confidence"] <= 0.88
    why = cause["replication"]["why_not"]
    assert why.startswith("no other flight was given")
    saved, flown = load_rig("a.toml"), load_rig("makki2024").replace(thrust_gain=0.62)
    assert saved.effects == {}
    # Other parameters take the part of the lag; their tolerances contain that.
    for name in ("thrust_gain", "dead_zone", "L_h"):
        assert abs(saved[name].value - flown[name].value) < saved[name].tolerance, name
    remark = f"Not confirmed, and not in this rig: rotor_lag ({why})."
    assert f"a.toml: {remark}" in result.out
    assert remark in " ".join(Path("a.toml").read_text().replace("#", "").split())
    assert "cause_found: Perhaps the rotors' thrust lags" in result.out
    assert "what to do next: fly another plan, and give that flight to --validate" in result.out
    assert "save the extended model" not in result.out
    assert "of the model without causes: elevation" in result.out and "their ratio" not in result.out


def test_flight_is_divided_into_two_folds_of_the_same_length() -> None:
    (record,) = diagnosed("rotor_lag=0.06").assessment.after.fit.problem.records
    (first,), (second,) = two_folds([record])
    assert first.used_s == pytest.approx(second.used_s, abs=2.0 * record.step_s)
    assert max(stop for _, stop in first.segments) <= min(start for start, _ in second.segments)
    assert two_folds([first, second]) == ((first,), (second,))
    beginning, _ = split(record, 3.0)
    assert beginning.used_s == pytest.approx(3.0)


def test_prediction_with_other_voltages_is_marked_as_extrapolation() -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    runs = diagnosis.held_out.extension.after
    (record,) = runs[0].fit.problem.records
    (same,) = extrapolations([record], runs)
    assert same.spans_s == ()
    mean_V = record.voltages_V.mean(axis=0)
    narrow = replace(record, voltages_V=mean_V + 0.1 * (record.voltages_V - mean_V))
    (outside,) = extrapolations([narrow], runs)
    assert len(outside.spans_s) == outside.windows > 0

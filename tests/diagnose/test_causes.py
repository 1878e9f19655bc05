"""A diagnosis finds a hidden effect, finds nothing if nothing is hidden, and reports an effect that the
catalogue lacks.
"""

import html
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from heli_host.data.arrays import Booleans, Floats
from heli_lab.diagnose import Diagnosis, diagnose, summary, to_json
from heli_lab.explain.contributions import accelerations
from heli_lab.explain.prediction import compare_free_runs
from heli_lab.fit import _kalman
from heli_lab.fit.identification import Trace, trace
from heli_lab.fit.problem import Fit
from heli_lab.report.diagnosis import figures
from heli_lab.report.diagnosis.figures import (
    figure_of_flight,
    figure_of_prediction,
    figure_of_torque,
    figure_of_windows,
)
from heli_lab.report.diagnosis.page import missing_terms, regions_section, write_report
from heli_lab.report.diagnosis.text import cautions, title
from heli_lab.report.identification_page import identification_figure
from heli_sim.evaluate.trajectories import AlongTrajectory, Trajectory
from heli_sim.model import MultibodyModel
from heli_sim.model.effects import catalogue, effects_of
from heli_sim.rig import load_rig, write_rig

from tests.diagnose.hidden import MADE_BY, SHORT_S, flights
from tests.diagnose.schema import conforms
from tests.running.kept import KEPT
from tests.running.long import samples

pytestmark = pytest.mark.diagnosis


@cache
def diagnosed(*effects: str, unlisted: bool = False) -> Diagnosis:
    """Diagnose flights with hidden effects, once for all test files of this folder."""
    # `unlisted` hides an effect that the catalogue lacks.
    fit, held_out = flights(*effects, unlisted=unlisted)
    return KEPT(
        f"diagnosed {effects} {unlisted} {SHORT_S}",
        lambda: diagnose(
            MultibodyModel(), load_rig("makki2024"), [fit], [held_out], labels=["fit", "held out"]
        ),
        made_by=MADE_BY,
    )


TRIED = ("rotor_lag", "input_delay", "thrust_asymmetry", "coulomb_friction.travel", "cable_spring.travel")
FEW_KINDS = {id_: kind for id_, kind in catalogue().items() if id_ in TRIED}


def briefly_diagnose(*effects: str, **options: Any) -> Diagnosis:
    """Diagnose flights with hidden effects; the catalogue has the effects `FEW_KINDS` only."""
    fit, held_out = flights(*effects)
    return diagnose(MultibodyModel(), load_rig("makki2024"), [fit], [held_out], kinds=FEW_KINDS, **options)


briefly_diagnosed = cache(briefly_diagnose)


def test_json_has_the_promised_keys_and_units_for_every_verdict() -> None:
    for diagnosis in (diagnosed(), diagnosed("rotor_lag=0.06"), diagnosed(unlisted=True)):
        conforms(to_json(diagnosis))


def test_attributes_of_a_cause_have_the_names_of_its_json() -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    (written,), (cause,) = to_json(diagnosis)["causes"], diagnosis.verdict.causes
    for name in ("effect", "sentence", "equation"):
        assert getattr(cause, name) == written[name]
    assert cause.id == cause.effect == "rotor_lag"
    assert round(cause.confidence, 3) == written["confidence"]
    assert list(cause.ambiguous_with) == written["ambiguous_with"]
    lag = cause.parameters["rotor_lag_s"]
    assert written["parameters"] == {"rotor_lag_s": {"value": lag.value, "std": lag.std, "unit": "s"}}
    assert abs(lag.value - 0.06) < 0.01
    assert cause.family is not None
    assert written["family"]["value"] == cause.family.value == lag.value
    assert written["family"]["std"] == pytest.approx(lag.std, rel=1e-6)
    assert set(written["family"]["members"]) == {"rotor_lag", "rotor_speed_lag", "rotor_lag_with_delay"}


def test_seed_determines_the_intervals_but_not_the_ratio() -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    extension = diagnosis.held_out.extension
    runs = extension.before, extension.after
    first, repeated, other_seed = (
        compare_free_runs(*runs, seed).horizons["2"]["pitch"] for seed in (1, 1, 2)
    )
    assert first == repeated
    assert first.interval95 != other_seed.interval95
    assert first.ratio == other_seed.ratio


def test_exhausted_refits_are_stated_with_the_verdict() -> None:
    fit, held_out = flights("rotor_lag=0.06")
    diagnosis = diagnose(MultibodyModel(), load_rig("makki2024"), [fit], [held_out], refits=0)
    numbers = to_json(diagnosis)
    conforms(numbers)
    assert numbers["complete"] is False
    assert numbers["causes"] == []
    assert "The limit of refits ended the search before everything was tried" in summary(diagnosis)
    assert any("--budget" in caution for caution in numbers["cautions"])


def test_resumed_search_has_the_result_of_an_uninterrupted_one(tmp_path: Path) -> None:
    complete = to_json(briefly_diagnosed("rotor_lag=0.06"))
    steps: list[str] = []

    def interrupt_at_second_refit(step: str, share: float) -> None:
        steps.append(step)
        if len([step for step in steps if step.startswith("trying")]) == 2:
            raise KeyboardInterrupt

    def run(say: Callable[[str, float], None] | None = None) -> Diagnosis:
        return briefly_diagnose("rotor_lag=0.06", resume=tmp_path / "search", say=say)

    with pytest.raises(KeyboardInterrupt):
        run(interrupt_at_second_refit)
    content = (tmp_path / "search").read_bytes()
    # An interruption while the last line is written leaves a part of it.
    (tmp_path / "search").write_bytes(content[:-200])
    resumed = to_json(run())
    assert {**resumed, "seconds_taken": 0.0} == {**complete, "seconds_taken": 0.0}


def test_nothing_hidden_is_explained_without_a_cause() -> None:
    diagnosis = diagnosed()
    numbers = to_json(diagnosis)
    assert numbers["verdict"] == "explained"
    assert numbers["causes"] == []
    assert numbers["unexplained"] is None
    assert numbers["residual"]["normalised"]["held_out_after"] < 1.05


@pytest.mark.parametrize(
    ("effect", "name", "truth"),
    [
        ("rotor_lag=0.06", "rotor_lag_s", 0.06),
        ("cable_spring.travel=0.06", "cable_spring_travel_Nm_per_rad", 0.06),
    ][: samples(2, 1)],
)
def test_hidden_effect_is_named_measured_and_halves_the_error(effect: str, name: str, truth: float) -> None:
    numbers = to_json(diagnosed(effect))
    assert numbers["verdict"] == "cause_found"
    first, *others = numbers["causes"]
    assert first["effect"] == effect.partition("=")[0]
    assert others == []
    estimate = first["parameters"][name]
    assert abs(estimate["value"] - truth) < 3.0 * estimate["std"]
    assert first["confidence"] > 0.9
    best = min(numbers["gain"]["axis"].values(), key=lambda reduction: reduction["ratio"])
    assert best["ratio"] < best["interval95"][1] < 0.5


def test_unlisted_effect_is_unexplained_and_depends_on_elevation() -> None:
    numbers = to_json(diagnosed(unlisted=True))
    assert numbers["verdict"] == "unexplained"
    assert numbers["causes"] == []
    assert numbers["unexplained"]["axis"] == "pitch"
    assert numbers["unexplained"]["correlates_with"][0] == "torque.pitch on elevation"
    assert numbers["unexplained"]["share_of_variance"] > 0.9
    assert "[[segment]]" in numbers["next_flight"]["plan"]


def test_curve_of_an_unlisted_cause_is_measured_but_not_in_the_rig() -> None:
    diagnosis = diagnosed(unlisted=True)
    (curve,) = diagnosis.curves
    # The hidden effect is 0.05 N m/rad; the curve has mN m and degrees, and no constant.
    slope = np.polyfit(curve.quantity, curve.value, 1)[0]
    assert slope == pytest.approx(50.0 * np.pi / 180.0, rel=0.1)
    assert diagnosis.held_out.splines["pitch"].ratio < 0.2
    assert diagnosis.error_reductions["pitch"].ratio == pytest.approx(1.0)
    assert diagnosis.rig("extended").effects == {}


@pytest.mark.parametrize(
    ("hidden", "on", "slope_mNm_per_deg"),
    [("cable_spring.travel=0.06", "travel", -60.0), ("", "elevation", 50.0)],
    ids=["in the catalogue", "not in the catalogue"],
)
def test_missing_torque_agrees_with_the_hidden_effect_without_its_equation(
    hidden: str, on: str, slope_mNm_per_deg: float
) -> None:
    diagnosis = briefly_diagnosed(hidden) if hidden else diagnosed(unlisted=True)
    (term,) = missing_terms(diagnosis)
    assert (term.what, term.unit, term.on, term.on_unit) == ("torque", "mN m", on, "deg")
    hidden_slope = slope_mNm_per_deg * np.pi / 180.0
    assert np.polyfit(term.quantity, term.missing, 1)[0] == pytest.approx(hidden_slope, rel=0.1)
    assert abs(np.polyfit(term.quantity, term.remaining, 1)[0]) < 0.1 * abs(hidden_slope)
    assert term.share > 0.8


def test_torque_of_a_right_lag_lies_on_the_line_of_its_equation() -> None:
    # A lag changes its torque within a block of the filter: values at the block's first step are 20 % larger.
    (term,) = missing_terms(diagnosed("rotor_lag=0.06"))
    assert np.polyfit(term.contribution, term.missing, 1)[0] == pytest.approx(1.0, abs=0.08)


def test_a_page_says_why_no_region_fails_although_something_is_missing() -> None:
    diagnosis = diagnosed(unlisted=True)
    nothing_fails = replace(
        diagnosis.failing_regions.after, fails=np.zeros_like(diagnosis.failing_regions.after.fails)
    )
    diagnosis = replace(diagnosis)
    # Replace the cached property `failing_regions`.
    diagnosis.__dict__["failing_regions"] = replace(diagnosis.failing_regions, after=nothing_fails)
    section = regions_section(diagnosis, lambda *_: None)
    assert "although the model lacks a torque" in section["note"]


def test_models_that_are_the_same_are_drawn_once() -> None:
    explained = diagnosed()
    assert not explained.assessment.extended.candidates
    fit = explained.held_out.extension.before[0].fit
    assert figure_of_torque(explained).axes[0].get_legend_handles_labels()[1][0].startswith("baseline")
    for figure in (figure_of_torque(explained), figure_of_windows(fit, fit), figure_of_flight(fit, fit)):
        labels = [label for panel in figure.axes for label in panel.get_legend_handles_labels()[1]]
        assert not any("after" in label or "extended" in label or "causes" in label for label in labels)


def test_no_figure_draws_a_line_through_a_part_that_was_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    before, after = (
        runs[0].fit for runs in (diagnosis.held_out.extension.before, diagnosis.held_out.extension.after)
    )
    border = trace(before).windows[2].start
    begin_s = float(trace(before).t_s[border - 1])

    def with_gap(t_s: Floats, is_after: Booleans) -> Floats:
        """Return times with 2.5 s left out before the rows of a mask."""
        return np.where(is_after, t_s + 2.5, t_s)

    def trace_with_gap(fit: Fit) -> Trace:
        run = trace(fit)
        return replace(run, t_s=with_gap(run.t_s, np.arange(len(run.t_s)) >= border))

    def accelerations_with_gap(*of: Any) -> tuple[Floats, Floats]:
        t_s, change_rad_s2 = accelerations(*of)
        return with_gap(t_s, t_s > begin_s), change_rad_s2

    monkeypatch.setattr(figures, "trace", trace_with_gap)
    monkeypatch.setattr(figures, "accelerations", accelerations_with_gap)
    drawn = (
        figures.figure_of_flight(before, after),
        figures.figure_of_size(diagnosis),
        identification_figure(trace_with_gap(after), "validation"),
    )
    for figure in drawn:
        assert figure is not None
        lines = [
            line for panel in figure.axes for line in panel.get_lines() if line.get_linestyle() != "None"
        ]
        points = [np.asarray(line.get_xydata()) for line in lines]
        # A line is interrupted where either coordinate is nan.
        spans_s = [np.abs(np.diff(np.where(np.isnan(xy).any(axis=1), np.nan, xy[:, 0]))) for xy in points]
        assert len(lines) >= 3 and max(float(np.nanmax(span_s, initial=0.0)) for span_s in spans_s) < 1.0


def test_each_run_of_a_prediction_shows_where_it_starts() -> None:
    before = diagnosed("rotor_lag=0.06").held_out.extension.before[0].fit
    run = trace(before)
    angle_panel = figure_of_prediction(before, before, "pitch").axes[0]
    starts = [np.asarray(line.get_xydata()) for line in angle_panel.get_lines() if line.get_marker() == "o"]
    assert len(starts) == len(run.windows)
    row = run.windows[1].start
    expected = (run.t_s[row], np.rad2deg(run.predicted_rad[row, 1]))
    assert starts[1][0] == pytest.approx(expected)


def test_causes_next_to_an_unlisted_effect_are_stated_with_perhaps() -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    other = diagnosed(unlisted=True)
    # A diagnosis with both: the lag as a cause, and the spline term of the other diagnosis as unexplained.
    verdict = replace(diagnosis.verdict, label="unexplained", unlisted=other.verdict.unlisted)
    unsure = replace(
        diagnosis,
        assessment=replace(diagnosis.assessment, verdict=verdict),
        search=other.search,
        replication=replace(diagnosis.replication, evaluation=other.held_out),
    )
    fact, perhaps = summary(unsure).split(" Together with it, perhaps: ")
    assert fact.startswith("The model lacks an effect that the catalogue does not list")
    assert "lags" not in fact
    assert "(confidence 0." in perhaps
    assert title(unsure).endswith("that the catalogue does not list, perhaps together with listed ones")


def test_parameter_far_from_its_prior_is_reported() -> None:
    diagnosis = diagnosed()
    assert diagnosis.prior_conflicts == ()
    after = diagnosis.assessment.after
    index = [parameter.name for parameter in after.fit.problem.free].index("offset_pitch")
    parameter = after.fit.problem.free[index]
    theta = after.fit.theta.copy()
    theta[index] = parameter.prior.mean + 4.1 * parameter.prior.std
    moved = replace(after, fit=replace(after.fit, theta=theta))
    conflicting = replace(diagnosis, assessment=replace(diagnosis.assessment, after=moved))
    (conflict,) = conflicting.prior_conflicts
    assert conflict.deviations == pytest.approx(4.1)
    (written,) = to_json(conflicting)["prior_conflicts"]
    assert written["parameter"] == "offset_pitch"
    assert written["without_prior"]["std"] > 0.0
    assert any("offset_pitch" in line and "4.1 standard deviations" in line for line in cautions(conflicting))


def test_extended_rig_file_contains_the_cause_with_its_size(tmp_path: Path) -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    write_rig(diagnosis.rig("extended"), tmp_path / "extended.toml")
    (effect,) = effects_of(load_rig(tmp_path / "extended.toml"))
    assert effect.name == "rotor_lag"
    assert effect.values["rotor_lag_s"] == pytest.approx(0.06, abs=0.003)


def uninformed(diagnosis: Diagnosis) -> set[str]:
    """Return the parameters whose standard error is above 0.9 times that of their prior."""
    fit = diagnosis.replication.prediction.fit
    priors = dict(zip(fit.problem.names, fit.problem.parameter_vector.std, strict=True))
    return {name for name, error in fit.std.items() if error > 0.9 * priors[name]}


def test_rig_states_which_parameters_the_flights_do_not_inform() -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    rig = diagnosis.rig("extended")
    sources = {
        name: rig[name].source for name in diagnosis.replication.prediction.fit.std if name in rig.numbers
    }
    marked = {name for name, source in sources.items() if source.startswith("not informed by fit;")}
    assert marked == uninformed(diagnosis)
    assert marked
    assert any(source.startswith("identified from fit;") for source in sources.values())


def test_report_is_self_contained_and_states_the_cause(tmp_path: Path) -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    page = write_report(diagnosis, tmp_path).read_text(encoding="utf-8")
    text = html.unescape(page)
    assert "The rotors' thrust lags their voltage by 0.0" in text
    assert "Rig makki2024, model multibody. Fitted: fit (" in text.partition('class="verdict')[0]
    assert "<i>F</i><sub>i</sub> thrust of rotor i" in text
    assert "time constant T</td>" in text
    table = text.partition("Parameters that these flights do not determine")[2].partition("</table>")[0]
    names = diagnosis.replication.prediction.fit.problem.names
    assert {name for name in names if f"<td>{name}</td>" in table} == uninformed(diagnosis)
    assert not any(scheme in page for scheme in ("http:", "https:"))
    assert {
        "cause.png",
        "prediction.png",
        "gain.png",
        "ranking.png",
        "flight.png",
        "torque.png",
        "index.html",
    } <= {path.name for path in tmp_path.iterdir()}


ROUNDING = 4e-16
"""Twice the rounding error of a double."""


def test_verdict_and_likelihoods_do_not_depend_on_rounding(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = briefly_diagnosed("rotor_lag=0.06")
    rng, along, filtered = np.random.default_rng(5), AlongTrajectory.__call__, _kalman.filter
    rounded = 0

    def with_rounding_error(values: Floats) -> Floats:
        nonlocal rounded
        rounded += 1
        return values * (1.0 + ROUNDING * rng.uniform(-1.0, 1.0, values.shape))

    def rounds_differently(self: AlongTrajectory, trajectory: Trajectory) -> list[Floats]:
        return [with_rounding_error(output) for output in along(self, trajectory)]

    def filters_differently(*system: Floats) -> tuple[Floats, ...]:
        return tuple(with_rounding_error(np.asarray(array)) for array in filtered(*system))

    monkeypatch.setattr(AlongTrajectory, "__call__", rounds_differently)
    monkeypatch.setattr(_kalman, "filter", filters_differently)
    other = briefly_diagnose("rotor_lag=0.06")
    assert rounded > 100
    assert other.label == plain.label == "cause_found"
    assert [cause.candidate.id for cause in other.verdict.causes] == ["rotor_lag"]
    log_likelihoods, other_log_likelihoods = _refit_log_likelihoods(plain), _refit_log_likelihoods(other)
    assert other_log_likelihoods.keys() == log_likelihoods.keys()
    for id_, log_likelihood in log_likelihoods.items():
        assert other_log_likelihoods[id_] == pytest.approx(log_likelihood, abs=0.1), id_
    gain, other_gain = (to_json(diagnosis)["gain"]["axis"] for diagnosis in (plain, other))
    for axis, reduction in gain.items():
        assert other_gain[axis]["ratio"] == pytest.approx(reduction["ratio"], rel=0.01)


def _refit_log_likelihoods(diagnosis: Diagnosis) -> dict[str, float]:
    """Return the log-likelihood of the last refit of each candidate in the search."""
    return {
        refit.candidate.id: refit.hypothesis.log_likelihood
        for round_ in diagnosis.search.rounds
        for refit in round_.refits
    }

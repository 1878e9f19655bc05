"""A remainder is unexplained only if it is no error of a parameter, and if it changes a prediction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from heli_host.data.flight import Flight
from heli_lab.diagnose import Diagnosis, to_json
from heli_lab.explain import verdict
from heli_lab.explain.candidates import quantity_values
from heli_lab.explain.comparison import ModelComparison
from heli_lab.explain.residuals import Dependence, dependences, open_loop_squares
from heli_lab.explain.screening import Screening
from heli_lab.explain.stepwise import held_out_screening
from heli_lab.explain.thresholds import MATTERS_COUNTS
from heli_lab.fit.records import prepare
from heli_lab.report.diagnosis.text import lines, summary
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig

from tests.diagnose.hidden import flights, hovering
from tests.diagnose.test_causes import diagnosed

pytestmark = pytest.mark.diagnosis


def significant(fit: Flight, held_out: Flight, *, uncertain: bool) -> list[Dependence]:
    """Test the baseline's residuals on the held-out flight, with or without the parameters' uncertainty."""
    rig = load_rig("makki2024")
    records = [prepare(fit, rig, "fit")], [prepare(held_out, rig, "held out")]
    comparison = ModelComparison(MultibodyModel(), rig, *records)
    baseline = comparison.refit(())
    if uncertain:
        screening = held_out_screening(comparison, baseline)
    else:
        screening = Screening(comparison.held_out_estimate(baseline))
    return [dependence for dependence in dependences([screening]) if dependence.is_significant]


def test_parameters_that_a_hover_does_not_show_are_no_missing_effect_in_another_flight() -> None:
    hover, (_, held_out) = hovering(20.0), flights()
    # As if the hover had shown them exactly, their error is structure.
    assert significant(hover, held_out, uncertain=False)
    assert not significant(hover, held_out, uncertain=True)


def test_unlisted_effect_remains_significant_on_another_flight() -> None:
    strongest, *_ = significant(*flights(unlisted=True), uncertain=True)
    assert strongest.what == "torque.pitch on elevation"
    assert strongest.change_counts > 10.0 * MATTERS_COUNTS


def test_linear_change_of_the_prediction_is_that_of_simulations() -> None:
    diagnosis = diagnosed(unlisted=True)
    (linear,) = Screening(diagnosis.search.baseline.estimate).filtered.linearised_flights
    hidden_Nm = 0.05 * quantity_values(linear.model.source, linear.trajectory)["elevation"]
    rates = linear.steps.by_disturbance[:, :, 1] * hidden_Nm[:, None]
    squares, rows = open_loop_squares(linear, rates)
    # Without the hidden torque, simulations of the baseline have this error in addition to the rounding.
    error_counts = np.sqrt((diagnosis.assessment.before.train.axes[1] ** 2 - 1.0) / 12.0)
    assert np.sqrt(squares[1] / rows) == pytest.approx(error_counts, rel=0.15)
    # A constant torque is estimated for each flight, so that it changes no prediction.
    constant, _ = open_loop_squares(linear, linear.steps.by_disturbance[:, :, 1])
    assert constant == pytest.approx(0.0, abs=1e-6)


def judged(change_counts: float, total: float = 1.4) -> Diagnosis:
    """Judge a right cause again whose model leaves a significant dependence of this size."""
    diagnosis = diagnosed("rotor_lag=0.06")
    assessment = diagnosis.assessment
    dependence = Dependence("torque.pitch on travel_rate", 24.0, 22.0, change_counts)
    residual = replace(assessment.residual_analysis, dependences=(dependence,))
    after = replace(assessment.after, held_out=replace(assessment.after.held_out, total=total))
    new_verdict = verdict.judge(diagnosis.search, residual, after, diagnosis.kinds, absent=False)
    return replace(
        diagnosis,
        assessment=replace(assessment, residual_analysis=residual, after=after, verdict=new_verdict),
    )


def test_remainder_that_changes_no_prediction_is_listed_and_the_cause_stands() -> None:
    diagnosis = judged(0.9 * MATTERS_COUNTS)
    assert diagnosis.label == "cause_found"
    assert summary(diagnosis).startswith("The rotors' thrust lags")
    numbers = to_json(diagnosis)
    (remaining,) = numbers["small_remainder"]
    assert (remaining["dependence"], remaining["change_counts"]) == (
        "torque.pitch on travel_rate",
        0.9 * MATTERS_COUNTS,
    )
    assert numbers["unexplained"] is None
    assert (
        "too small to matter: a torque about pitch that depends on travel rate, which no effect of the "
        "catalogue explains; it changes the 2 s open-loop prediction by 0.09 encoder counts rms, less than "
        "0.1"
    ) in lines(diagnosis)


def test_estimate_that_did_not_converge_is_stated() -> None:
    diagnosis = diagnosed("rotor_lag=0.06")
    assert to_json(diagnosis)["converged"] is True
    final = diagnosis.search.final
    rough = replace(final, estimate=replace(final.estimate, converged=False))
    numbers = to_json(replace(diagnosis, search=replace(diagnosis.search, final=rough)))
    assert numbers["converged"] is False
    assert any(
        "the estimate of the final model did not converge" in caution for caution in numbers["cautions"]
    )
    after = diagnosis.assessment.after
    unfinished = replace(after, fit=replace(after.fit, converged=False))
    assessment = replace(diagnosis.assessment, after=unfinished)
    numbers = to_json(replace(diagnosis, assessment=assessment))
    assert numbers["converged"] is False
    assert any("the free runs of the extended model did not converge" in c for c in numbers["cautions"])


def test_remainder_that_changes_the_prediction_stays_unexplained() -> None:
    diagnosis = judged(1.1 * MATTERS_COUNTS)
    assert diagnosis.label == "unexplained"
    assert diagnosis.verdict.remainder == ()
    # In large disturbances, every significant effect matters, and so does what remains.
    after = diagnosis.assessment.after
    disturbed = replace(after, train=replace(after.train, total=6.0))
    small = judged(0.9 * MATTERS_COUNTS).assessment.residual_analysis
    args = diagnosis.search, small, disturbed, diagnosis.kinds
    assert verdict.judge(*args, absent=False).label == "unexplained"

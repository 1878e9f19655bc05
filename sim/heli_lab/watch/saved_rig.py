"""Which causes of a diagnosis a saved rig has: those with which no axis is forecast worse than without
them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.errors import HeliError
from heli_sim.model.base import Model
from heli_sim.model.effect import AXES
from heli_sim.rig import Rig

from heli_lab.errors import IdentifyError, TwinError
from heli_lab.explain.prediction import ErrorReduction
from heli_lab.explain.result import Diagnosis, Proposal, model_and_rig
from heli_lab.explain.thresholds import MATTERS_COUNTS
from heli_lab.fit.records import Record
from heli_lab.watch.disturbances import learn_disturbances
from heli_lab.watch.forecast import Forecasts, HorizonErrors, MAIN_HORIZON_s, errors_at, forecasts_of
from heli_lab.watch.steps import count_rad_of

MAX_RATIO: Final = 1.1
"""Largest error of an axis with the causes, divided by that without them. By judgement. Larger: a model that
predicts an axis worse is saved. Smaller: chance leaves out right causes of short flights."""
_SHARE_OF_RANGE: Final = 0.8
"""Share of the judged flight's rates that the fitted flights must reach for their range to count as the
same."""


class RigModel(NamedTuple):
    """Equations of motion, and the rig with their parameters."""

    model: Model
    rig: Rig


class JudgedFlight(NamedTuple):
    """A flight whose forecasts decide."""

    label: str
    flight: Flight
    span_s: tuple[float | None, float | None]  # Part that is used, None without a limit


@dataclass(frozen=True)
class LeftOutCause:
    """A cause that a saved rig does not have."""

    effect: str  # Id of the effect
    axis: str  # Axis that is forecast worse with it
    reduction: ErrorReduction  # Its error at `MAIN_HORIZON_s` without and with the causes
    remedy: str  # Flight that would show whether the cause or its size is wrong

    @property
    def sentence(self) -> str:
        """State why the cause is left out, and what to fly."""
        growth = 100.0 * (self.reduction.ratio - 1.0)
        return (
            f"{self.effect} is left out of the rig: with it, the forecast error of {self.axis} at "
            f"{MAIN_HORIZON_s:g} s grows by {growth:.0f} % ({self.reduction.before_deg:.3g} to "
            f"{self.reduction.after_deg:.3g} deg). {self.remedy}"
        )


@dataclass(frozen=True)
class SavedRig:
    """A rig for a file, with the forecast errors that were measured with it."""

    rig: Rig
    left_out: tuple[LeftOutCause, ...]
    lines: tuple[str, ...]  # Forecast error of each axis, and the range in which it was measured
    has_term: bool = False  # Whether the rig has the proposed equation


TERM: Final = "the proposed equation"


def saved_rig(
    result: Diagnosis, name: str, forecast: Forecaster, *, with_unconfirmed: bool, with_term: bool = False
) -> SavedRig:
    """Make the extended rig called `name`, without causes with which an axis is forecast worse by more than
    `MAX_RATIO`. The same decides on a proposed equation. `forecast` forecasts the flights that decide.
    """
    if with_term and result.proposal is not None:
        with_equation = _with_equation(result, result.proposal, name, forecast)
        if with_equation.has_term:
            return with_equation
        saved = saved_rig(result, name, forecast, with_unconfirmed=with_unconfirmed)
        return replace(saved, left_out=(*with_equation.left_out, *saved.left_out))
    ids = [cause.effect for cause in result.verdict.causes] if with_unconfirmed else result.confirmed_ids

    def rig_with(causes: Sequence[str]) -> Rig:
        """Return the rig with some of the causes; with all of them, it needs no new estimate."""
        if list(causes) == ids:
            return result.rig(name, with_unconfirmed=with_unconfirmed)
        return result.rig(name, with_unconfirmed=False, only=causes)

    left_out: list[LeftOutCause] = []
    kept_causes = list(ids)
    try:
        baseline = forecast(rig_with([])) if ids else None
        forecasts = forecast(rig_with(kept_causes))
        while baseline is not None and kept_causes:
            errors = at_horizon(forecasts, baseline)
            axis = worst_axis(errors, forecast.count_deg)
            if axis is None:
                break
            assert errors.reduction is not None
            harmful = _most_harmful(kept_causes, axis, lambda causes: forecast(rig_with(causes)))
            remedy = what_to_fly(axis, result.assessment.before.fit.problem.records, forecasts)
            left_out.append(LeftOutCause(harmful, axis, errors.reduction[axis], remedy))
            kept_causes.remove(harmful)
            forecasts = forecast(rig_with(kept_causes))
    except HeliError as error:
        return SavedRig(rig_with(kept_causes), (), (unmeasured_sentence(error),))
    return SavedRig(rig_with(kept_causes), tuple(left_out), forecast_lines(forecasts))


def unmeasured_sentence(error: HeliError) -> str:
    """State why a rig file has no forecast errors."""
    return f"Forecasts were not measured: {error}"


def _with_equation(result: Diagnosis, proposal: Proposal, name: str, forecast: Forecaster) -> SavedRig:
    """Make the rig with the proposed equation, or state with which axis it is left out."""
    rig = result.rig(name, with_term=True)
    model, _ = model_and_rig(proposal.term.discovery.hypothesis)
    try:
        forecasts = forecast_flights(model, rig, forecast.judged)
        errors = at_horizon(forecasts, forecast(result.rig(name, only=())))
    except HeliError as error:
        return SavedRig(rig, (), (unmeasured_sentence(error),), has_term=True)
    axis = worst_axis(errors, forecast.count_deg)
    if axis is None:
        return SavedRig(rig, (), forecast_lines(forecasts), has_term=True)
    assert errors.reduction is not None
    remedy = what_to_fly(axis, result.assessment.before.fit.problem.records, forecasts)
    return SavedRig(rig, (LeftOutCause(TERM, axis, errors.reduction[axis], remedy),), ())


@dataclass(frozen=True)
class RigComparison:
    """Forecasts with an identified rig, compared with those of the rig before."""

    labels: tuple[str, ...]  # Flights that were forecast
    reductions: Mapping[str, ErrorReduction]  # By axis, at `MAIN_HORIZON_s`
    worse: tuple[str, ...]  # Axes that are forecast worse by more than `MAX_RATIO`
    lines: tuple[
        str, ...
    ]  # Warnings, the forecast error of each axis, and the range in which it was measured


def compare_rigs(
    before: RigModel, after: RigModel, judged: Sequence[JudgedFlight], fitted: Iterable[Record]
) -> RigComparison:
    """Compare the forecasts of equations and rig before and after an identification from `fitted` flights."""
    forecasts = forecast_flights(after.model, after.rig, judged)
    errors = at_horizon(forecasts, forecast_flights(before.model, before.rig, judged))
    assert errors.reduction is not None
    count_deg = _count_deg(judged, after.rig)
    worse_axes = [axis for axis in AXES if axis in growing_axes(errors, count_deg)]
    warnings = [
        f"With this rig, the forecast error of {axis} at {MAIN_HORIZON_s:g} s is "
        f"{errors.reduction[axis].ratio:.2f} times that of the rig before "
        f"({errors.reduction[axis].before_deg:.3g} to {errors.reduction[axis].after_deg:.3g} deg). "
        f"{what_to_fly(axis, fitted, forecasts)}"
        for axis in worse_axes
    ]
    labels = tuple(flight.label for flight in forecasts)
    return RigComparison(labels, errors.reduction, tuple(worse_axes), (*warnings, *forecast_lines(forecasts)))


def comparison_json(comparison: RigComparison) -> dict[str, Any]:
    """Write a comparison as a JSON object; docs/reference/json.md describes its keys."""
    return {
        "horizon_s": MAIN_HORIZON_s,
        "flights": list(comparison.labels),
        "axis": {axis: _reduction_json(reduction) for axis, reduction in comparison.reductions.items()},
        "worse": list(comparison.worse),
    }


def saved_json(saved: SavedRig) -> dict[str, Any]:
    """Write which causes a saved rig has as a JSON object; docs/reference/json.md describes its keys."""
    return {
        "effects": sorted(saved.rig.effects),
        "left_out": [
            {
                "effect": cause.effect,
                "axis": cause.axis,
                **_reduction_json(cause.reduction),
                "sentence": cause.sentence,
            }
            for cause in saved.left_out
        ],
    }


def _reduction_json(reduction: ErrorReduction) -> dict[str, Any]:
    return {
        "before_deg": reduction.before_deg,
        "after_deg": reduction.after_deg,
        "ratio": reduction.ratio,
        "interval95": list(reduction.interval95),
    }


def _count_deg(judged: Sequence[JudgedFlight], rig: Rig) -> Floats:
    """Return the largest angle of a count of each encoder in some flights, (3,) [deg]."""
    counts_rad = [count_rad_of(each.flight, rig) for each in judged]
    return np.asarray(np.rad2deg(np.max(counts_rad, axis=0, initial=0.0)))


class Forecaster:
    """Forecasts of the `judged` flights with a rig; each rig is computed once."""

    # `model_of` makes the equations of a rig with its effects. `rig` states the encoders.

    def __init__(self, judged: Sequence[JudgedFlight], model_of: Callable[[Rig], Model], rig: Rig) -> None:
        self.judged, self.model_of = judged, model_of
        self.count_deg = _count_deg(judged, rig)  # (3,): A count
        self._known: dict[tuple[str, ...], list[Forecasts]] = {}

    def __call__(self, rig: Rig) -> list[Forecasts]:
        """Return the forecasts with a rig, one per flight that is long enough."""
        # The rigs of a diagnosis differ only by their effects and the refits with these.
        key = tuple(sorted(rig.effects))
        if key not in self._known:
            self._known[key] = forecast_flights(self.model_of(rig), rig, self.judged)
        return self._known[key]


def forecast_flights(model: Model, rig: Rig, judged: Sequence[JudgedFlight]) -> list[Forecasts]:
    """Forecast the flights that are long enough up to `MAIN_HORIZON_s`; raise the last error if none is."""
    forecasts, refused = [], HeliError("no flight was given", "give a flight to --validate")
    for label, flight, span_s in judged:
        try:
            disturbances = learn_disturbances(model, rig, flight, label)
            forecasts.append(forecasts_of(model, rig, disturbances, flight, label, span_s, MAIN_HORIZON_s))
        except (TwinError, IdentifyError) as error:
            refused = error
    if not forecasts:
        raise refused
    return forecasts


def at_horizon(forecasts: Sequence[Forecasts], baseline: Sequence[Forecasts] | None) -> HorizonErrors:
    """Return the errors at `MAIN_HORIZON_s`, and their reduction if there is a `baseline`; a TwinError is
    raised if no flight is long enough.
    """
    errors = errors_at(MAIN_HORIZON_s, forecasts, baseline)
    if errors is None:
        raise TwinError(
            f"no flight lasts {MAIN_HORIZON_s:g} s after the first forecast", "give a longer flight"
        )
    return errors


def worst_axis(errors: HorizonErrors, count_deg: Floats) -> str | None:
    """Return the axis whose error grows most among `growing_axes`; None if there are none. Shapes:
    `count_deg` (3,).
    """
    ratios = growing_axes(errors, count_deg)
    return max(ratios, key=lambda axis: ratios[axis]) if ratios else None


def growing_axes(errors: HorizonErrors, count_deg: Floats) -> dict[str, float]:
    """Return the ratio of the errors of each axis whose error grows by more than `MAX_RATIO` and by more than
    `MATTERS_COUNTS` encoder counts. Shapes: `count_deg` (3,).
    """
    assert errors.reduction is not None
    return {
        axis: reduction.ratio
        for (axis, reduction), count in zip(errors.reduction.items(), count_deg, strict=True)
        if reduction.ratio > MAX_RATIO and reduction.after_deg - reduction.before_deg > MATTERS_COUNTS * count
    }


def _most_harmful(
    ids: Sequence[str], axis: str, forecast_with: Callable[[Sequence[str]], list[Forecasts]]
) -> str:
    """Return the cause without which the error of an axis is smallest."""
    if len(ids) == 1:
        return ids[0]

    def error_without(id_: str) -> float:
        errors = at_horizon(forecast_with([other for other in ids if other != id_]), baseline=None)
        return errors.with_causes[axis]

    return min(ids, key=error_without)


def what_to_fly(axis: str, fitted: Iterable[Record], judged: Sequence[Forecasts]) -> str:
    """State the flight that would show whether a cause or its size is wrong."""
    number = AXES.index(axis)
    judged_deg_s = float(np.rad2deg(max(np.abs(flight.range_rad_s[:, number]).max() for flight in judged)))
    fitted_deg_s = float(np.rad2deg(max(_highest_rate_rad_s(record, number) for record in fitted)))
    labels = ", ".join(flight.label for flight in judged)
    if fitted_deg_s < _SHARE_OF_RANGE * judged_deg_s:
        return (
            f"{axis} turns with up to {judged_deg_s:.0f} deg/s in {labels}, and with up to "
            f"{fitted_deg_s:.0f} deg/s in the fitted flights: fly a plan with {judged_deg_s:.0f} deg/s, and "
            "add it to the flights to fit."
        )
    return (
        f"Fly one more flight like {labels}, fit both flights, and validate on a third flight: the cause is "
        f"wrong if {axis} is still forecast worse."
    )


def _highest_rate_rad_s(record: Record, axis: int) -> float:
    """Return the rate of an axis that a hundredth of a flight exceeds [rad/s]."""
    rows = max(1, round(0.1 / record.step_s))
    rates = [
        np.abs(record.angles_rad[start + rows : stop, axis] - record.angles_rad[start : stop - rows, axis])
        for start, stop in record.segments
        if stop - start > rows
    ]
    return float(np.quantile(np.concatenate(rates), 0.99)) / (rows * record.step_s) if rates else 0.0


def forecast_lines(forecasts: Sequence[Forecasts]) -> tuple[str, ...]:
    """State the forecast error of each axis at `MAIN_HORIZON_s`, and the range in which it was measured."""
    errors = at_horizon(forecasts, baseline=None)
    labels = ", ".join(flight.label for flight in forecasts)
    low_V = np.min([flight.range_V[0] for flight in forecasts], axis=0)
    high_V = np.max([flight.range_V[1] for flight in forecasts], axis=0)
    low_deg_s = np.rad2deg(np.min([flight.range_rad_s[0] for flight in forecasts], axis=0))
    high_deg_s = np.rad2deg(np.max([flight.range_rad_s[1] for flight in forecasts], axis=0))
    return (
        f"Forecast error at {MAIN_HORIZON_s:g} s, rms on {labels}, at "
        f"front {low_V[0]:.1f} to {high_V[0]:.1f} V, back {low_V[1]:.1f} to {high_V[1]:.1f} V:",
        *(
            f"  {axis}: {errors.with_causes[axis]:.3g} deg, at {low:z.3g} to {high:z.3g} deg/s"
            for axis, low, high in zip(AXES, low_deg_s, high_deg_s, strict=True)
        ),
    )

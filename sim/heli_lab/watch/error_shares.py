"""Divides the error of forecasts into parts of named causes, of disturbances, and of what is unknown.

The parts are mean squares, because these add up. The model is forecast without the causes, with them, and
with curves in the place of what no effect explains:

    causes       error without the causes, less the error with them
    unknown      the part of the remaining error that the curves predict on a flight that did not fit them,
                 and the part that exceeds the error that the disturbances themselves would cause
    disturbances the rest

The strength of the disturbances is estimated from the same flight. An unknown effect that looks like a random
torque therefore counts as a disturbance, as long as no curve predicts it.

The remaining error is also compared over ranges of voltages, angles and rates. The fitted flights choose a
range, and the judged flights must confirm it.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Booleans, Floats
from heli_sim.model.effect import AXES
from heli_sim.rig import Rig

from heli_lab.explain.result import Diagnosis, model_and_rig
from heli_lab.fit.problem import PER_FLIGHT
from heli_lab.watch.forecast import Forecasts, HorizonErrors, HORIZONS_s, MAIN_HORIZON_s, START_EVERY_s
from heli_lab.watch.saved_rig import Forecaster, JudgedFlight, at_horizon, forecast_flights

_MAX_RATIO: Final = 1.5
"""Mean square error of a right model, divided by that which its disturbances cause, that chance allows. On
eight simulated flights of right models it was 0.76 to 1.27 (2026-11). Lower: chance is called unknown.
Higher: unknown effects are called disturbances."""
_BINS: Final = 3
"""Ranges of a quantity that are compared: a low, a middle and a high one with equally many forecasts. More:
too few independent forecasts in a range."""
_CHANCE: Final = 0.01
"""Probability that a range is stated although the error does not depend on it, for each axis."""
_MIN_FORECASTS: Final = 8
"""Fewest independent forecasts in a range, and outside of it, with which the range is tested."""
_START_QUANTITIES: Final = (
    "the front voltage",
    "the back voltage",
    *AXES,
    *(f"the rate of {axis}" for axis in AXES),
)
_UNITS: Final = ("V", "V", "deg", "deg", "deg", "deg/s", "deg/s", "deg/s")


@dataclass(frozen=True)
class LargeErrorRange:
    """A range of a quantity at the start of a forecast with larger errors than elsewhere."""

    quantity: str
    unit: str
    low: float  # low, high: Ends of the range, infinite for an open end
    high: float
    ratio: float  # Root mean square error within the range, divided by that outside, on the judged flights

    @property
    def text(self) -> str:
        """Describe the range in words."""
        place = f"between {self.low:.3g} and {self.high:.3g} {self.unit}"
        if np.isinf(self.low):
            place = f"below {self.high:.3g} {self.unit}"
        elif np.isinf(self.high):
            place = f"above {self.low:.3g} {self.unit}"
        return f"{self.quantity} {place}"


class ErrorPart(NamedTuple):
    """A part of a mean square error."""

    deg: float  # Root of its mean square, with the sign of the part
    share: float  # Share of the mean square without the causes


@dataclass(frozen=True)
class AxisShares:
    """Parts of the mean square error of an axis. `causes`, `disturbances` and `unknown` add up to the error
    without the causes.
    """

    before_deg: float  # Root mean square error without the causes
    after_deg: float  # Root mean square error with the causes
    unknown_deg2: float  # Part of the mean square that is unknown
    larger_where: LargeErrorRange | None  # Range in which the remaining error is larger, if one is confirmed

    @property
    def parts_deg2(self) -> Mapping[str, float]:
        """Mean square by part [deg2]; that of the causes is negative if they make forecasts worse."""
        return {
            "causes": self.before_deg**2 - self.after_deg**2,
            "disturbances": self.after_deg**2 - self.unknown_deg2,
            "unknown": self.unknown_deg2,
        }

    @property
    def parts(self) -> Mapping[str, ErrorPart]:
        """The same parts in degrees, and as shares."""
        total_deg2 = self.before_deg**2
        return {
            name: ErrorPart(
                float(np.copysign(abs(part_deg2) ** 0.5, part_deg2)),
                part_deg2 / total_deg2 if total_deg2 > 0.0 else 0.0,
            )
            for name, part_deg2 in self.parts_deg2.items()
        }


@dataclass(frozen=True)
class ErrorShares:
    """Parts of the error of forecasts at `MAIN_HORIZON_s`."""

    labels: tuple[str, ...]  # Flights that were forecast
    has_other_flight: bool  # Whether these flights did not fit the model
    axes: Mapping[str, AxisShares]
    curves: tuple[str, ...]
    """Curves that predict a part of the error, ``CHANNEL on QUANTITY``; empty if none does."""
    unresolved: tuple[str, ...] = ()
    """Significant dependences, ``CHANNEL on QUANTITY``, that no curve predicts; their part of the error is
    among the disturbances."""


def error_shares(
    result: Diagnosis, forecast: Forecaster, fitted: Callable[[], Sequence[JudgedFlight]]
) -> ErrorShares:
    """Divide the error of the flights that `forecast` forecasts: the held-out flights, or the fitted ones if
    there are no others.
    """
    # `fitted` reads the fitted flights, which only an unexplained error needs.
    # A HeliError is raised if no flight is long enough for forecasts.
    extended_rig = result.rig("extended", with_unconfirmed=True)
    with_causes = forecast(extended_rig)
    without_causes = forecast(result.rig("baseline", with_unconfirmed=False, only=()))
    errors = at_horizon(with_causes, without_causes)
    assert errors.reduction is not None
    unknown = _unknown_error(result, forecast, extended_rig, with_causes)
    ranges: list[LargeErrorRange | None] = [None] * len(AXES)
    if result.has_other_flight and result.label == "unexplained":
        of_fitted = forecast_flights(forecast.model_of(extended_rig), extended_rig, fitted())
        ranges = [_range_of_large_errors(of_fitted, with_causes, axis) for axis in range(len(AXES))]
    is_any_curve_confirmed = bool(unknown.is_curve_confirmed.any())
    return ErrorShares(
        labels=tuple(flight.label for flight in with_causes),
        has_other_flight=result.has_other_flight,
        axes={
            axis: AxisShares(
                before_deg=errors.reduction[axis].before_deg,
                after_deg=errors.with_causes[axis],
                unknown_deg2=float(unknown_deg2),
                larger_where=range_,
            )
            for axis, unknown_deg2, range_ in zip(AXES, unknown.square_deg2, ranges, strict=True)
        },
        curves=_curve_names(result) if is_any_curve_confirmed else (),
        unresolved=() if is_any_curve_confirmed else _unresolved(result),
    )


class _UnknownError(NamedTuple):
    """The part of the error with the causes that is unknown."""

    square_deg2: Floats  # (3,): Mean square [deg2]
    is_curve_confirmed: Booleans  # (3,): Whether the curves predict a part of it


def _unknown_error(
    result: Diagnosis, forecast: Forecaster, rig: Rig, with_causes: Sequence[Forecasts]
) -> _UnknownError:
    """Return what the curves predict of the error with the causes, and what exceeds the disturbances."""
    error_deg2 = _mean_square_deg2(at_horizon(with_causes, baseline=None))
    expected_deg2 = _expected_deg2(with_causes)
    is_curve_confirmed = np.zeros(len(AXES), bool)
    predicted_deg2 = np.zeros(len(AXES))
    if result.curved is not None and result.has_other_flight:
        model, curved_rig = model_and_rig(result.curved)
        # Zeros and constant torques of both models are the same, so that the curves alone differ.
        constants = {name: rig[name].value for name in PER_FLIGHT if name in rig}
        with_curves = forecast_flights(model, curved_rig.replace(**constants), forecast.judged)
        errors = at_horizon(with_curves, with_causes)
        assert errors.reduction is not None
        # The whole 95 % interval of the ratio of the errors is below 1.
        is_curve_confirmed = np.array([max(errors.reduction[axis].interval95) < 1.0 for axis in AXES])
        predicted_deg2 = np.where(is_curve_confirmed, error_deg2 - _mean_square_deg2(errors), 0.0)
        expected_deg2 = np.where(is_curve_confirmed, _expected_deg2(with_curves), expected_deg2)
    remaining_deg2 = error_deg2 - predicted_deg2
    is_excess = remaining_deg2 > _MAX_RATIO * expected_deg2
    excess_deg2 = np.where(is_excess, remaining_deg2 - expected_deg2, 0.0)
    return _UnknownError(predicted_deg2 + excess_deg2, is_curve_confirmed)


def _mean_square_deg2(errors: HorizonErrors) -> Floats:
    """Return the mean square error of the model about each axis, (3,) [deg2]."""
    return np.array([errors.with_causes[axis] ** 2 for axis in AXES])


def _expected_deg2(forecasts: Sequence[Forecasts]) -> Floats:
    """Return the mean square error that the disturbances cause, (3,) [deg2]."""
    counts = [len(flight.start_s) for flight in forecasts]
    expected_rad2 = np.average([flight.expected_rad2 for flight in forecasts], axis=0, weights=counts)
    return np.asarray(np.rad2deg(1.0) ** 2 * expected_rad2)


def _unresolved(result: Diagnosis) -> tuple[str, ...]:
    """Name the significant dependences that no effect explains, ``CHANNEL on QUANTITY``."""
    if result.label != "unexplained":
        return ()
    unlisted = [" on ".join(cause.candidate.dependence) for cause in result.verdict.unlisted]
    dependences = result.assessment.residual_analysis.dependences
    return tuple(unlisted or [dependence.what for dependence in dependences if dependence.matters])


def _curve_names(result: Diagnosis) -> tuple[str, ...]:
    """Name the curves of a diagnosis, ``CHANNEL on QUANTITY``."""
    assert result.curved is not None
    return tuple(
        " on ".join(candidate.dependence) for candidate in result.curved.candidates if candidate.is_spline
    )


class _Samples(NamedTuple):
    """Independent forecasts of some flights."""

    quantities: Floats  # (k, quantities): Quantities at the start, in the units of `_UNITS`
    squares: Floats  # (k, 3): Squared errors at `MAIN_HORIZON_s`


def _independent(forecasts: Sequence[Forecasts]) -> _Samples:
    """Return forecasts that do not overlap."""
    horizon = HORIZONS_s.index(MAIN_HORIZON_s)
    starts_per_horizon = round(MAIN_HORIZON_s / START_EVERY_s)
    quantities, squares = [], []
    for flight in forecasts:
        of_flight = flight.squares_rad2(horizon)
        rows = np.flatnonzero(np.isfinite(of_flight).all(axis=1))[::starts_per_horizon]
        squares.append(of_flight[rows])
        angles = np.rad2deg(np.hstack((flight.start_rad[rows], flight.start_rad_s[rows])))
        quantities.append(np.hstack((flight.start_V[rows], angles)))
    return _Samples(np.vstack(quantities), np.vstack(squares))


def _range_of_large_errors(
    fitted: Sequence[Forecasts], judged: Sequence[Forecasts], axis: int
) -> LargeErrorRange | None:
    """Return the range in which the fitted flights have the clearest larger errors about an axis, if the
    judged flights have them there too.
    """
    of_fitted, of_judged = _independent(fitted), _independent(judged)

    def chance(samples: _Samples, bin_: _Bin) -> float:
        return _chance_of(samples.squares[:, axis], bin_.contains(samples))

    clearest = min(_bins(of_fitted), key=lambda bin_: chance(of_fitted, bin_))
    if chance(of_judged, clearest) > _CHANCE:
        return None  # the judged flights do not confirm the range
    is_inside = clearest.contains(of_judged)
    squares = of_judged.squares[:, axis]
    return LargeErrorRange(
        _START_QUANTITIES[clearest.quantity],
        unit=_UNITS[clearest.quantity],
        low=clearest.low,
        high=clearest.high,
        ratio=float(np.sqrt(squares[is_inside].mean() / squares[~is_inside].mean())),
    )


class _Bin(NamedTuple):
    """A range of a quantity at the start of forecasts; the first and the last range are open."""

    quantity: int  # Its place in `_START_QUANTITIES`
    low: float
    high: float

    def contains(self, samples: _Samples) -> Booleans:
        """Whether each forecast began within the range."""
        quantity = samples.quantities[:, self.quantity]
        return np.asarray((self.low < quantity) & (quantity <= self.high), bool)


def _bins(samples: _Samples) -> list[_Bin]:
    """Divide each quantity into `_BINS` ranges with equally many forecasts."""
    edges = np.quantile(samples.quantities, np.arange(1, _BINS) / _BINS, axis=0)  # (bins - 1, quantities)
    return [
        _Bin(quantity, low, high)
        for quantity, inner_edges in enumerate(edges.T.tolist())
        for low, high in itertools.pairwise([-math.inf, *inner_edges, math.inf])
    ]


def _chance_of(squares: Floats, is_inside: Booleans) -> float:
    """Return the probability of errors as large as those inside if these do not differ from the others."""
    if min(is_inside.sum(), (~is_inside).sum()) < _MIN_FORECASTS:
        return 1.0  # too few for a test
    # The import takes half a second of CPU time, which only unexplained errors need.
    from scipy.stats import mannwhitneyu

    return float(mannwhitneyu(squares[is_inside], squares[~is_inside], alternative="greater").pvalue)


def shares_json(shares: ErrorShares) -> dict[str, Any]:
    """Write the parts as a JSON object; docs/reference/json.md describes its keys."""
    return {
        "horizon_s": MAIN_HORIZON_s,
        "flights": list(shares.labels),
        "held_out": shares.has_other_flight,
        "axis": {axis: _axis_json(of_axis) for axis, of_axis in shares.axes.items()},
        "depends_on": list(shares.curves),
        "unresolved": list(shares.unresolved),
    }


def _axis_json(shares: AxisShares) -> dict[str, Any]:
    where = shares.larger_where
    return {
        "before_deg": shares.before_deg,
        "after_deg": shares.after_deg,
        **{name: part._asdict() for name, part in shares.parts.items()},
        "larger_where": None
        if where is None
        else {
            "quantity": where.quantity.removeprefix("the "),
            "unit": where.unit,
            "low": where.low if np.isfinite(where.low) else None,
            "high": where.high if np.isfinite(where.high) else None,
            "ratio": where.ratio,
        },
    }

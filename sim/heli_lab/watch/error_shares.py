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

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Booleans, Floats, Integers
from heli_sim.model.effect import AXES

from heli_lab.explain.result import Diagnosis, model_and_rig
from heli_lab.fit.problem import PER_FLIGHT
from heli_lab.watch.forecast import Forecasts, HORIZONS_s, MAIN_HORIZON_s, START_EVERY_s
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
    has_other_flight = result.has_other_flight
    extended = result.rig("extended", with_unconfirmed=True)
    remaining = forecast(extended)
    baseline = forecast(result.rig("baseline", with_unconfirmed=False, only=()))
    errors = at_horizon(remaining, baseline)
    assert errors.reduction is not None
    square_deg2 = np.array([errors.with_causes[axis] ** 2 for axis in AXES])
    unknown_deg2 = np.zeros(len(AXES))
    is_curve_confirmed = np.zeros(len(AXES), bool)
    least_deg2, least = square_deg2, remaining
    if result.curved is not None and has_other_flight:
        model, rig = model_and_rig(result.curved)
        # Zeros and constant torques of both models are the same, so that the curves alone differ.
        constants = {name: extended[name].value for name in PER_FLIGHT if name in extended}
        curved = forecast_flights(model, rig.replace(**constants), forecast.judged)
        with_curves = at_horizon(curved, remaining)
        assert with_curves.reduction is not None
        is_curve_confirmed = np.array([with_curves.reduction[axis].interval95[1] < 1.0 for axis in AXES])
        curved_deg2 = np.array([with_curves.with_causes[axis] ** 2 for axis in AXES])
        unknown_deg2 = np.where(is_curve_confirmed, square_deg2 - curved_deg2, 0.0)
        least_deg2 = square_deg2 - unknown_deg2
        least = curved
    expected_deg2 = np.where(is_curve_confirmed, _expected_deg2(least), _expected_deg2(remaining))
    excess_deg2 = np.where(least_deg2 > _MAX_RATIO * expected_deg2, least_deg2 - expected_deg2, 0.0)
    unknown_deg2 = unknown_deg2 + excess_deg2
    ranges: list[LargeErrorRange | None] = [None] * len(AXES)
    if has_other_flight and result.label == "unexplained":
        of_fitted = forecast_flights(forecast.model_of(extended), extended, fitted())
        ranges = [_larger_where(of_fitted, remaining, number) for number in range(len(AXES))]
    return ErrorShares(
        tuple(flight.label for flight in remaining),
        has_other_flight,
        {
            axis: AxisShares(
                errors.reduction[axis].before_deg, errors.with_causes[axis], float(unknown), larger_where
            )
            for axis, unknown, larger_where in zip(AXES, unknown_deg2, ranges, strict=True)
        },
        curves=_curve_names(result) if is_curve_confirmed.any() else (),
        unresolved=() if is_curve_confirmed.any() else _unresolved(result),
    )


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
    horizon, every = HORIZONS_s.index(MAIN_HORIZON_s), round(MAIN_HORIZON_s / START_EVERY_s)
    quantities, squares = [], []
    for flight in forecasts:
        of_flight = flight.squares_rad2(horizon)
        rows = np.flatnonzero(np.isfinite(of_flight).all(axis=1))[::every]
        squares.append(of_flight[rows])
        angles = np.rad2deg(np.hstack((flight.start_rad[rows], flight.start_rad_s[rows])))
        quantities.append(np.hstack((flight.start_V[rows], angles)))
    return _Samples(np.vstack(quantities), np.vstack(squares))


def _larger_where(
    fitted: Sequence[Forecasts], judged: Sequence[Forecasts], axis: int
) -> LargeErrorRange | None:
    """Return the range in which the fitted flights have the clearest larger errors about an axis, if the
    judged flights have them there too.
    """
    of_fitted, of_judged = _independent(fitted), _independent(judged)
    edges = np.quantile(of_fitted.quantities, np.arange(1, _BINS) / _BINS, axis=0)  # (bins - 1, quantities)
    best = (1.0, 0, 0)
    for number in range(len(_START_QUANTITIES)):
        for chosen in range(_BINS):
            is_inside = _is_inside(of_fitted, edges, number, chosen)
            best = min(best, (_chance_of(of_fitted.squares[:, axis], is_inside), number, chosen))
    _, number, chosen = best
    is_inside = _is_inside(of_judged, edges, number, chosen)
    squares = of_judged.squares[:, axis]
    if _chance_of(squares, is_inside) > _CHANCE:
        return None
    ends = np.concatenate(([-np.inf], edges[:, number], [np.inf]))
    return LargeErrorRange(
        _START_QUANTITIES[number],
        unit=_UNITS[number],
        low=float(ends[chosen]),
        high=float(ends[chosen + 1]),
        ratio=float(np.sqrt(squares[is_inside].mean() / squares[~is_inside].mean())),
    )


def _is_inside(samples: _Samples, edges: Floats, quantity: int, chosen: int) -> Booleans:
    """Whether each forecast began in the bin `chosen` of a quantity. Shapes: `edges` (bins - 1,
    quantities).
    """
    bins: Integers = np.searchsorted(edges[:, quantity], samples.quantities[:, quantity])
    return np.asarray(bins == chosen, bool)


def _chance_of(squares: Floats, is_inside: Booleans) -> float:
    """Return the probability of errors as large as those inside if these do not differ from the others."""
    if min(is_inside.sum(), (~is_inside).sum()) < _MIN_FORECASTS:
        return 1.0
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

"""The calibration of a twin, and its file.

It contains the disturbances and the uncertainty of the rig, and the tail of the evidence without a change: a
generalised Pareto tail of block maxima, which sets the alarm threshold.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.files import TOML_BYTES, decode_text, parse_toml, read_file, toml_string, write_signed
from heli_host.errors import file_remedy
from heli_sim.model import model_named
from heli_sim.model.base import Model
from heli_sim.model.effects import effects_of
from heli_sim.rig import Rig, load_rig
from scipy.optimize import brentq, minimize
from scipy.stats import genpareto

from heli_lab.errors import TwinError
from heli_lab.fit.flight_model import DISTURBANCE_START
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.watch.model_check import STATED, PieceVariance
from heli_lab.watch.twin_model import EXACT, ParameterUncertainty

SEGMENT_s: Final = 5.0
"""Length of the segments whose maxima are counted as excursions of the evidence, s. An onset stays in the
window for some seconds. Longer: few excursions to fit. Shorter: one excursion counts several times, and the
alarms are rarer than stated."""
_LEVEL: Final = 0.8
"""Share of the segments whose maxima are below the level at which the generalised Pareto tail begins."""
_MIN_SCALE_nats: Final = 1.0
"""Scale of the tail of a likelihood ratio for white innovations, nats: by Wilks it falls by e per nat."""
_SHAPE_STD: Final = 0.05
"""Standard deviation of the shape before any flight was seen; its mean is 0. The evidence is half a square of
a sum of many innovations, so its tail is exponential but for a remainder of their outliers. Larger: thirty
excesses, which leave the shape open to 0.2, let the alarm level go to hundreds of nats. Smaller: outliers do
not count."""
_SUPPORTED_LENGTHS: Final = 120.0
"""Longest interval between false alarms that healthy flights support, in their own length: 30 s support one
false alarm per hour. Their tail is then extrapolated by two powers of ten. More: the rate is a guess. Less:
a useful rate needs more flights than users have."""
_MIN_SEGMENTS: Final = 10
"""Fewest segments for a tail: with `_LEVEL`, two of their maxima are above the level. By judgement."""
_NODES: Final = 15
"""Number of nodes of the Gauss-Hermite quadrature in each of its two dimensions."""


@dataclass(frozen=True)
class Tail:
    """Generalised Pareto tail of the evidence without a change."""

    level_nats: float  # Lowest evidence that the tail describes [nats]
    per_hour: float  # Rate of excursions above the level, per hour of free flight
    scale_nats: float  # Scale of the excesses over the level [nats]; their mean where the shape is 0
    excesses: int  # Number of excursions from which scale and shape were estimated
    shape: float = 0.0  # Shape of the tail; 0 is an exponential one, more is a heavier one
    healthy_s: float = math.inf
    """Length of the healthy flights along which the excursions were drawn [s]; infinite for simulated ones.
    """

    @property
    def supported_interval_h(self) -> float:
        """Longest mean time between two false alarms that the healthy flights support [h]."""
        return _SUPPORTED_LENGTHS * self.healthy_s / 3600.0

    def threshold_nats(self, false_alarm_interval_h: float) -> float:
        """Return the evidence that is exceeded once per `false_alarm_interval_h` of free flight [nats]."""
        # The rate is averaged over the tails that could have given the excesses. If the healthy flights do
        # not support the interval, the longest supported one is used.
        interval_h = min(false_alarm_interval_h, self.supported_interval_h)
        expected_excursions = self.per_hour * interval_h
        if expected_excursions <= 1.0 or not math.isfinite(self.level_nats):
            return self.level_nats
        shapes, scales_nats, weights = self._posterior_tails()

        def log_expected_alarms(excess_nats: float) -> float:
            """Logarithm of the expected number of excursions in the interval above an excess."""
            chance = weights @ genpareto.sf(excess_nats, shapes, scale=scales_nats)
            return math.log(max(float(chance), 1e-300)) + math.log(expected_excursions)

        # The threshold is where one alarm is expected: double the excess until fewer are, then find the root.
        high_nats = self.scale_nats
        while log_expected_alarms(high_nats) > 0.0:
            high_nats *= 2.0
        return self.level_nats + float(brentq(log_expected_alarms, 0.0, high_nats, xtol=1e-6))

    def _posterior_tails(self) -> _PosteriorTails:
        """Return tails from the posterior of shape and log scale, with weights of Gauss-Hermite
        quadrature.
        """
        # The posterior is approximately normal. Its precision is the sum of the Fisher information of the
        # generalised Pareto distribution and the precision of the shape's prior.
        # The Fisher information is infinite at a shape of -1/2.
        xi = max(self.shape, -0.4)
        # Information of a single excess about shape and log scale (Smith 1987), (2, 2).
        fisher = np.array([[2.0 / (1.0 + xi), 1.0 / (1.0 + xi)], [1.0 / (1.0 + xi), 1.0]]) / (1.0 + 2.0 * xi)
        precision = self.excesses * fisher + np.diag([_SHAPE_STD**-2.0, 0.0])
        # Shape and log scale are their means plus root @ u, with a standard normal u, (2,).
        root = np.linalg.cholesky(np.linalg.inv(precision))
        nodes, node_weights = np.polynomial.hermite_e.hermegauss(_NODES)
        first, second = (grid.ravel() for grid in np.meshgrid(nodes, nodes))
        weights = np.outer(node_weights, node_weights).ravel()
        return _PosteriorTails(
            shapes=self.shape + root[0, 0] * first,
            scales_nats=self.scale_nats * np.exp(root[1, 0] * first + root[1, 1] * second),
            weights=weights / weights.sum(),
        )


class _PosteriorTails(NamedTuple):
    """Shapes and scales [nats] of tails that could have given the excesses, and their probabilities, (k,)."""

    shapes: Floats
    scales_nats: Floats
    weights: Floats


IDEAL: Final = Tail(4.29, per_hour=145.0, scale_nats=1.08, excesses=58)
"""Tail of a twin with the true parameters, from 24 simulated flights of the rig makki2024 in the disturbances
of a quiet room. No trained twin has a lower threshold: nominal flights may show less by chance. Without this
bound, 63 rigs had 19 flights with an alarm where 9.9 were accepted; with a level 1 nat higher, 7."""


def segment_maxima(history: Sequence[tuple[float, float]]) -> list[float]:
    """Return the largest evidence [nats] of each segment of `SEGMENT_s`."""
    t_s, evidence_nats = np.array(history, float).reshape(-1, 2).T
    is_known = np.isfinite(evidence_nats)
    t_s, evidence_nats = t_s[is_known], evidence_nats[is_known]
    if not len(t_s):
        return []
    segment_number = ((t_s - t_s[0]) // SEGMENT_s).astype(int)
    return [float(evidence_nats[segment_number == segment].max()) for segment in np.unique(segment_number)]


def fit_tail(flights: Sequence[Sequence[tuple[float, float]]], healthy_s: float = math.inf) -> Tail:
    """Fit the tail of the evidence to nominal flights."""
    maxima = [maximum for history in flights for maximum in segment_maxima(history)]
    if len(maxima) < _MIN_SEGMENTS:
        raise TwinError(
            f"{len(maxima)} segments of {SEGMENT_s:g} s of nominal flight are too few for a threshold",
            "give a longer flight",
        )
    level_nats = float(np.quantile(maxima, _LEVEL))
    excesses_nats = np.array([maximum - level_nats for maximum in maxima if maximum > level_nats])
    shape, scale_nats = _fit_excesses(excesses_nats)
    flight_h = len(maxima) * SEGMENT_s / 3600.0
    return Tail(
        level_nats,
        per_hour=len(excesses_nats) / flight_h,
        scale_nats=max(scale_nats, _MIN_SCALE_nats),
        excesses=len(excesses_nats),
        shape=shape,
        healthy_s=healthy_s,
    )


def _fit_excesses(excesses_nats: Floats) -> tuple[float, float]:
    """Return the most probable shape and scale [nats] of a generalised Pareto distribution of excesses."""

    def minus_log_posterior(shape_and_log_scale: Floats) -> float:
        shape, scale = float(shape_and_log_scale[0]), math.exp(shape_and_log_scale[1])
        log_likelihood = genpareto.logpdf(excesses_nats, shape, scale=scale).sum()
        if not math.isfinite(log_likelihood):
            return 1e9  # an excess is beyond the end of this tail
        return 0.5 * (shape / _SHAPE_STD) ** 2 - float(log_likelihood)

    best = minimize(
        minus_log_posterior,
        [0.0, math.log(excesses_nats.mean())],
        method="Nelder-Mead",
        options={"xatol": 1e-4},
    )
    return float(best.x[0]), math.exp(best.x[1])


_AXES, _ROTORS = 3, 2
_DISTURBANCES: Final = ("fast_std_Nm", "correlation_time_s", "slow_std_Nm", "quantisation")
"""Entries of the table [disturbances] of a twin file."""


_TAIL_DEFAULTS: Final[Mapping[str, float | None]] = {
    "level_nats": None,
    "per_hour": None,
    "scale_nats": None,
    "shape": 0.0,
    "healthy_s": math.inf,
}
"""Numbers in the table [tail], each with its default; None if a file must have it."""


_REMEDY: Final = "write it again with heli-host twin --learn"


DEFAULT_DISTURBANCES: Final = replace(DISTURBANCE_START, quantisation=np.ones(3))
"""Disturbances of a rig without nominal flights: gusts of a quiet room, encoders that round."""


@dataclass(frozen=True)
class Calibration:
    """Calibration of a twin."""

    disturbances: DisturbanceModel  # Gusts and drift of the rig, and the quantisation of its encoders
    tail: Tail  # Tail of the evidence in nominal flights
    source: str = ""  # Flights from which both were estimated
    uncertainty: ParameterUncertainty = EXACT
    """Errors of the rig's parameters, as far as these flights leave them open."""
    piece_variance: PieceVariance = STATED
    """Variance of the innovations' sums over 1 s in these flights, which the tail contains."""

    @property
    def has_learned(self) -> bool:
        """Whether flights of the machine set the disturbances; otherwise, the rate of false alarms holds for
        simulated flights.
        """
        return self.uncertainty is not EXACT

    def threshold_nats(self, false_alarm_interval_h: float) -> float:
        """Return the alarm threshold [nats] for one false alarm per `false_alarm_interval_h`."""
        # If the nominal flights support only a shorter interval, the threshold is that of the longest
        # supported interval. The threshold is at least that of a twin with the true parameters.
        return max(
            self.tail.threshold_nats(false_alarm_interval_h), IDEAL.threshold_nats(false_alarm_interval_h)
        )


def _calibration_text(calibration: Calibration, rig: str) -> str:
    """Return the text of a twin file (TOML); `rig` is the name or the path of the rig."""
    disturbance_lines = "".join(
        f"{key} = {_toml_list(getattr(calibration.disturbances, key.removesuffix('_Nm')))}\n"
        for key in _DISTURBANCES
    )
    numbers = ("level_nats", "per_hour", "scale_nats", "excesses", "shape", "healthy_s")
    tail_lines = "".join(f"{name} = {getattr(calibration.tail, name):.6g}\n" for name in numbers)
    return (
        "# A twin: a rig, its disturbances, and the tail of the evidence without a change.\n"
        "# Written by heli-host twin; order of the axes: elevation, pitch, travel.\n"
        f"rig = {toml_string(rig)}\n"
        f"source = {toml_string(calibration.source)}\n\n"
        "[disturbances]\n"
        f"{disturbance_lines}\n"
        "[tail]\n"
        f"{tail_lines}"
    ) + (_piece_variance_text(calibration.piece_variance) + _uncertainty_text(calibration.uncertainty))


def _piece_variance_text(measured: PieceVariance) -> str:
    """Return the table [innovations] of a twin file; empty if no flight was learned."""
    if measured is STATED:
        return ""
    return (
        f"\n[innovations]\npiece_variance = {_toml_list(measured.variance)}\npieces = {measured.pieces:g}\n"
    )


def _uncertainty_text(uncertainty: ParameterUncertainty) -> str:
    """Return the table [parameters] of a twin file; empty for exact parameters."""
    if not uncertainty.names and not uncertainty.supply_std:
        return ""
    names = ", ".join(map(toml_string, uncertainty.names))
    rows = "".join(f"  {_toml_list(row, 9)},\n" for row in uncertainty.covariance)
    return (
        "\n[parameters]\n"
        f"names = [{names}]\n"
        f"supply_std = {uncertainty.supply_std:.6g}\n"
        f"low_V = {_toml_list(uncertainty.low_V)}\n"
        f"high_V = {_toml_list(uncertainty.high_V)}\n"
        f"covariance = [\n{rows}]\n"
    )


def write_calibration(path: Path, calibration: Calibration, rig: str) -> None:
    """Write a twin file to `path`; `rig` is the name or the path of the rig."""
    write_signed(path, _calibration_text(calibration, rig))


def _parse_calibration(data: Mapping[str, Any], name: str) -> Calibration:
    """Read the calibration in a twin file."""
    return Calibration(
        _parse_disturbances(_table_of(data, "disturbances", name), name),
        _parse_tail(_table_of(data, "tail", name), name),
        source=str(data.get("source", "")),
        uncertainty=_parse_uncertainty(_table_of(data, "parameters", name), name)
        if "parameters" in data
        else EXACT,
        piece_variance=_parse_piece_variance(_table_of(data, "innovations", name), name)
        if "innovations" in data
        else STATED,
    )


def _parse_piece_variance(table: Mapping[str, Any], name: str) -> PieceVariance:
    """Read the table [innovations] of a twin file."""
    variance = _number_array(table.get("piece_variance"), _AXES, f"{name}: innovations.piece_variance")
    pieces = table.get("pieces")
    if not np.all(variance > 0.0):
        raise TwinError(f"{name}: innovations.piece_variance is not {_AXES} positive numbers", _REMEDY)
    if not _is_positive(pieces):
        raise TwinError(f"{name}: innovations.pieces is not a positive number", _REMEDY)
    return PieceVariance(variance, float(table["pieces"]))


def _parse_disturbances(table: Mapping[str, Any], name: str) -> DisturbanceModel:
    """Read the table [disturbances] of a twin file."""
    arrays: dict[str, Any] = {}
    for key in _DISTURBANCES:
        values = table.get(key)
        if not isinstance(values, list) or len(values) != _AXES or not all(map(_is_positive, values)):
            raise TwinError(f"{name}: disturbances.{key} is not three positive numbers", _REMEDY)
        arrays[key.removesuffix("_Nm")] = np.array(values, float)
    return DisturbanceModel(**arrays)


def _parse_tail(table: Mapping[str, Any], name: str) -> Tail:
    """Read the table [tail] of a twin file."""
    excesses = table.get("excesses")
    if not isinstance(excesses, int) or isinstance(excesses, bool) or excesses < 1:
        raise TwinError(f"{name}: tail.excesses is not a count", _REMEDY)
    tail_numbers: dict[str, float] = {}
    for key, default in _TAIL_DEFAULTS.items():
        value = table.get(key, default)
        if not _is_number(value) and value != math.inf:
            raise TwinError(f"{name}: tail.{key} is not a number", _REMEDY)
        tail_numbers[key] = float(value)
    return Tail(**tail_numbers, excesses=excesses)


def _parse_uncertainty(table: Mapping[str, Any], name: str) -> ParameterUncertainty:
    """Read the table [parameters] of a twin file."""
    names = table.get("names")
    if not isinstance(names, list) or not all(isinstance(entry, str) for entry in names):
        raise TwinError(f"{name}: parameters.names is not a list of names", _REMEDY)
    count = len(names)
    rows = table.get("covariance")
    if not isinstance(rows, list) or len(rows) != count:
        raise TwinError(f"{name}: parameters.covariance does not have {count} rows", _REMEDY)
    covariance = [_number_array(row, count, f"{name}: a row of parameters.covariance") for row in rows]
    (supply_std,) = _number_array([table.get("supply_std")], 1, f"{name}: parameters.supply_std")
    return ParameterUncertainty(
        tuple(names),
        covariance=np.array(covariance, float).reshape(count, count),
        supply_std=float(supply_std),
        low_V=_number_array(table.get("low_V"), _ROTORS, f"{name}: parameters.low_V"),
        high_V=_number_array(table.get("high_V"), _ROTORS, f"{name}: parameters.high_V"),
    )


def _number_array(values: Any, count: int, what: str) -> Floats:
    """Return `values` as an array, (count,); a TwinError about `what` is raised for other values."""
    if not isinstance(values, list) or len(values) != count or not all(map(_is_number, values)):
        raise TwinError(f"{what} is not {count} numbers", _REMEDY)
    return np.array(values, float)


def _table_of(data: Mapping[str, Any], key: str, name: str) -> Mapping[str, Any]:
    """Return a table of a twin file; a TwinError is raised if it is missing."""
    table = data.get(key)
    if not isinstance(table, dict):
        raise TwinError(f"{name} has no [{key}]", _REMEDY)
    return table


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_positive(value: Any) -> bool:
    return _is_number(value) and value > 0


def _toml_list(values: Floats, digits: int = 6) -> str:
    """Return values, (n,), as a list of TOML with this number of significant digits."""
    return "[" + ", ".join(f"{value:.{digits}g}" for value in values) + "]"


DEFAULT_CALIBRATION: Final = Calibration(DEFAULT_DISTURBANCES, IDEAL, "a quiet room")
"""Calibration of a rig without a twin file: the tail is that of simulated flights of the rig makki2024 with
these disturbances."""


@dataclass(frozen=True)
class TwinRig:
    """A rig, its model and the calibration: everything that a twin needs."""

    rig: Rig  # Parameters of the rig
    model: Model  # Equations of motion with the effects that the rig file states
    calibration: Calibration  # Disturbances and tail of the evidence without a change
    name: str  # Name of the rig, or path of its file


def open_rig(name: str) -> TwinRig:
    """Read a rig file or a twin file."""
    path = Path(name)
    calibration = DEFAULT_CALIBRATION
    rig_name = name
    if path.suffix == ".toml" and path.is_file():
        data = _parse_file(path)
        if "tail" in data and "disturbances" in data:
            calibration = _parse_calibration(data, name)
            rig_entry = data.get("rig")
            if not isinstance(rig_entry, str) or not rig_entry:
                raise TwinError(f"{name} names no rig", "write it again with heli-host twin --learn")
            rig_path = path.parent / rig_entry
            rig_name = str(rig_path) if rig_path.is_file() else rig_entry
    rig = load_rig(rig_name)
    model = model_named(rig.model or "multibody", effects_of(rig))
    return TwinRig(rig, model, calibration, rig_name)


def _parse_file(path: Path) -> dict[str, Any]:
    """Return the content of a TOML file; a TwinError is raised if it cannot be read."""
    try:
        return parse_toml(decode_text(read_file(path, TOML_BYTES)))
    except OSError as error:
        raise TwinError(f"cannot read {path}: {error.strerror or error}", file_remedy(error)) from error
    except ValueError as error:
        raise TwinError(f"{path} is not TOML: {error}", "correct that line") from error

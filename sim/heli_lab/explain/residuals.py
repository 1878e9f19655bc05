"""Residual analysis: tests whether a better model could predict the innovations of the final model.

Innovations are one-step prediction errors. If a model is right, they are white and uncorrelated with all
earlier states and inputs, in closed loop too. Many simple functions of state, input and time are tested as
regressors of the innovations. A significant regressor is structure that the model lacks.

For the regions in which a model fails, the plane of two quantities is divided into cells. A torque that acts
in one cell only is tested as a regressor of the innovations, with the free parameters projected out. If the
model is right, its score in standard deviations is standard normal. The false discovery rate of all cells is
controlled (Benjamini and Hochberg, J. R. Statist. Soc. B 57, 1995). The method follows "Where Is My Physics
Wrong?" (arXiv 2606.23215), with innovations instead of residuals, because residuals of flights under
disturbances are correlated.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final, NamedTuple

import numpy as np
from heli_host.data.arrays import Booleans, Floats, Integers
from heli_sim.model.effect import AXES

from heli_lab.explain import thresholds
from heli_lab.explain.candidates import (
    Candidate,
    Regressors,
    ScoredCandidate,
    channel_kind,
    channel_place,
    quantity_values,
    spline_candidates,
)
from heli_lab.explain.screening import ScoreStatistics, Screening, coefficient_std, score_of
from heli_lab.explain.thresholds import FALSE_DISCOVERY_RATE, KICK_STD_ERRORS
from heli_lab.fit.estimator import Estimate
from heli_lab.fit.grey_box import DisturbanceModel
from heli_lab.fit.innovations import (
    AuxiliaryResiduals,
    FlightErrors,
    InnovationsModel,
    ModelErrors,
    auxiliary_residuals,
    smoothed_disturbances,
)
from heli_lab.fit.linearised_flight import BLOCK_s, LinearisedFlight
from heli_lab.threads import batches

_PRODUCTS: Final = (
    "elevation",
    "pitch",
    "travel",
    "elevation_rate",
    "pitch_rate",
    "travel_rate",
    "thrust",
    "thrust_difference",
)
_RATES: Final = ("elevation_rate", "pitch_rate", "travel_rate")
_THRUSTS: Final = ("thrust", "thrust_difference")
_LOWPASS_s: Final = (0.05, 0.2, 1.0)
"""Time constants of first-order lags of the thrust: those of rotors, of inflow, of warming motors."""
_PLAY_WIDTHS: Final = (0.1, 0.3, 1.0)
"""Widths of a play (hysteresis), in standard deviations of the thrust."""
_REST_WIDTHS: Final = (0.05, 0.2)
"""Rates up to which an axis is nearly at rest, in standard deviations: there dry friction acts."""


def _dependence_functions(
    quantities: Sequence[Mapping[str, Floats]], scales: Mapping[str, _Scale], step_s: float
) -> dict[str, list[Floats]]:
    """Test functions along each flight, shape (n, s), by name; `quantities` has the values (n,) of each
    flight.
    """
    # Each list has one entry per flight.
    standardised = [
        {name: (values[name] - scale.mean) / scale.std for name, scale in scales.items()}
        for values in quantities
    ]
    functions = {name: [values[name][:, None] for values in standardised] for name in _PRODUCTS}
    for first, second in itertools.combinations(_PRODUCTS, 2):
        products = [(values[first] * values[second])[:, None] for values in standardised]
        functions[f"{first} times {second}"] = products
    for name in _THRUSTS:
        functions[f"past {name}"] = [_memory_curves(values[name], step_s) for values in standardised]
    for name in _RATES:
        # Divided by the standard deviation, and not centred: rest is where the rate is 0.
        rates = [values[name] / scales[name].std for values in quantities]
        functions[f"{name} near rest"] = [_near_rest_curves(rate) for rate in rates]
    return functions


class _Scale(NamedTuple):
    """Mean and standard deviation of a quantity over all flights."""

    mean: float
    std: float


def _scale(values_by_flight: Sequence[Floats]) -> _Scale:
    """Compute mean and standard deviation of a quantity, (n,) per flight; the latter is never 0."""
    all_values = np.concatenate(values_by_flight)
    return _Scale(all_values.mean(), all_values.std() + 1e-12)


def _near_rest_curves(rate: Floats) -> Floats:
    """Return curves of a scaled rate (n,) that look like dry friction near rest, shape (n, widths)."""
    # The sign of the rate, smooth within a tenth of the width, and fading out beyond the width.
    return np.column_stack(
        [np.tanh(rate / 0.1 / width) * np.exp(-((rate / width) ** 2)) for width in _REST_WIDTHS]
    )


def _memory_curves(signal: Floats, step_s: float) -> Floats:
    """Return how first-order lags and plays would change a signal (n,), shape (n, s)."""
    values = signal.tolist()
    outputs = [_low_pass(values, math.exp(-step_s / time_s)) for time_s in _LOWPASS_s]
    outputs += [_play(values, width) for width in _PLAY_WIDTHS]
    changes: Floats = np.column_stack(outputs) - signal[:, None]
    return changes


def _low_pass(values: Sequence[float], pole: float) -> list[float]:
    """Return values behind a first-order lag with the given pole, which starts at rest."""

    def next_output(output: float, value: float) -> float:
        return output + (1.0 - pole) * (value - output)

    return list(itertools.accumulate(values, next_output))


def _play(values: Sequence[float], width: float) -> list[float]:
    """Return values behind a play (backlash) of a given `width`."""

    def next_output(output: float, value: float) -> float:
        return min(max(output, value - width / 2.0), value + width / 2.0)

    return list(itertools.accumulate(values, next_output))


_MAX_KICKS: Final = 30
"""Kicks that are sought in all flights together; each takes one pass of the smoother."""
_STD_PER_MAD: Final = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


@dataclass(frozen=True)
class Kicks:
    """Kicks about one axis in all fitted flights."""

    count: int  # Number of kicks
    largest_Nms: float  # Largest angular impulse, a torque times its duration, without its sign


def kicks(
    filtered: InnovationsModel, disturbances: DisturbanceModel, error: FlightErrors | None = None
) -> dict[str, Kicks]:
    """Count the kicks about each axis; axes without kicks are left out."""
    # `error` are the errors of the model, by default those of `filtered`.
    # The most significant impulse is subtracted before the next one is sought, because it also raises the
    # statistics of instants close to it.
    error = filtered.perturbed_residual() if error is None else error
    impulses_Nms: dict[str, list[float]] = {}
    for _ in range(_MAX_KICKS):
        residuals = auxiliary_residuals(filtered, disturbances, error)
        statistics = [_robust_statistics(residual) for residual in residuals]
        flight = int(np.argmax([statistic.max(initial=0.0) for statistic in statistics]))
        interval, axis = np.unravel_index(int(statistics[flight].argmax()), statistics[flight].shape)
        if statistics[flight][interval, axis] < KICK_STD_ERRORS:
            break
        torque_Nm = float(residuals[flight].impulse.size[interval, axis])
        step_s = filtered.linearised_flights[flight].reference.step_s
        impulses_Nms.setdefault(AXES[axis], []).append(abs(torque_Nm) * step_s)
        error = with_impulse(filtered, error, flight, int(interval), int(axis), torque_Nm)
    return {axis: Kicks(len(sizes), max(sizes)) for axis, sizes in impulses_Nms.items()}


def with_impulse(
    filtered: InnovationsModel, error: FlightErrors, flight: int, interval: int, axis: int, torque_Nm: float
) -> FlightErrors:
    """Return the `error` of a model with one more impulse, so that the next one can be sought."""
    changed = [list(windows) for windows in error]
    for number, blocks in enumerate(filtered.linearised_flights[flight].blocks):
        if interval < len(blocks.rows):
            drive, measured = changed[flight][number]
            drive = drive.copy()
            # The torque acts during the first step of the block.
            drive[interval, :, 0] += blocks.part_input[0, interval, :, axis] * torque_Nm
            changed[flight][number] = ModelErrors(drive, measured)
            break
        interval -= len(blocks.rows)
    return changed


def _robust_statistics(residual: AuxiliaryResiduals) -> Floats:
    """Return absolute t statistics of impulses, (k, 3), over their robust standard deviation."""
    # Kicks inflate the estimated disturbances, so that the statistics themselves are too small: the scale, at
    # most 1, only enlarges them.
    statistic = residual.impulse.t_statistic
    scale = _STD_PER_MAD * np.median(np.abs(statistic - np.median(statistic, axis=0)), axis=0)
    result: Floats = np.abs(statistic) / np.clip(scale, 1e-6, 1.0)
    return result


_WINDOW_s: Final = 2.0
"""Length of a prediction [s], as in the free runs of an evaluation."""
_RIDGE: Final = 1e-9
"""Share of the largest diagonal element that is added, because an output may not depend on a state."""


class _SquareSums(NamedTuple):
    """Sums of the squares of each output in some rows."""

    squares: Floats  # (m, k)
    rows: int


def open_loop_squares(linear: LinearisedFlight, rates: Floats) -> _SquareSums:
    """Sum up the squares of the change of the outputs by each of k additional rates, shape (n, states, k), in
    all windows of a flight. Initial states and constant torques are refitted to each change.
    """
    length = max(1, round(_WINDOW_s / linear.reference.step_s))
    starts = np.array(
        [start for w in linear.windows for start in range(w.start, w.stop - length + 1, length)], int
    )
    outputs = len(linear.model.outputs)
    if not starts.size:  # all parts of the flight are shorter than a window
        return _SquareSums(np.zeros((outputs, rates.shape[2])), 0)
    rows = starts[:, None] + np.arange(length)
    response = _responses(linear, rows, rates) / linear.reference.record.resolution[:, None]
    # Windows, then all outputs at all steps of a window, then the signals.
    signals = response.reshape(len(starts), length * outputs, -1)
    states = linear.states
    initial, others = signals[:, :, :states], signals[:, :, states:]
    remaining = others - initial @ _solve(initial, others)
    # The constant torques are the same in all windows.
    stacked = remaining.reshape(-1, remaining.shape[2])
    constants, change = stacked[:, :outputs], stacked[:, outputs:]
    change = change - constants @ _solve(constants, change)
    return _SquareSums(np.sum(change.reshape(-1, outputs, change.shape[1]) ** 2, axis=0), rows.size)


def _responses(linear: LinearisedFlight, rows: Integers, rates: Floats) -> Floats:
    """Simulate the deviation of each window, shape (windows, length, m, states + m + k): from an initial
    state of 1, by a constant torque of 1 about each axis, and by each of the additional `rates`.
    """
    steps, (windows, length), states = linear.steps, rows.shape, linear.states
    outputs = len(linear.model.outputs)
    first_rate = states + outputs
    deviation = np.zeros((windows, states, first_rate + rates.shape[2]))
    deviation[:, :, :states] = np.eye(states)
    response = np.empty((windows, length, outputs, deviation.shape[2]))
    for number in range(length):
        at = rows[:, number]
        response[:, number] = steps.C[at] @ deviation
        deviation = steps.Phi[at] @ deviation
        deviation[:, :, states:first_rate] += steps.Gamma[at] @ steps.by_disturbance[at][:, :, :outputs]
        deviation[:, :, first_rate:] += steps.Gamma[at] @ rates[at]
    return response


def _solve(design: Floats, target: Floats) -> Floats:
    """Return the least-squares coefficients of the columns of `design` for those of `target`; both may have
    a leading dimension.
    """
    transposed = np.swapaxes(design, -1, -2)
    normal = transposed @ design
    size = normal.shape[-1]
    diagonal = np.einsum("...ii->...i", normal).max(axis=-1)[..., None, None]
    return np.asarray(
        np.linalg.solve(normal + _RIDGE * (diagonal + 1e-300) * np.eye(size), transposed @ target)
    )


_MAX_CORRELATES: Final = 4
"""Longest list that a report shows."""
_TORQUE_STD_Nm: Final = (0.1, 0.03, 0.05)
"""Prior standard deviation of the coefficients about each axis: wide, of the size of the rigs' frictions."""
_TEST_SPLINES: Final = 99
"""A number above those of a model's own spline terms, so that parameter names differ."""
_SIMULATED_TOGETHER: Final = 8
"""Functions whose changes of the prediction are simulated together. Fewer: the answer to initial states is
simulated more often; with one, a quarter of a diagnosis of forty flights. More: memory, 0.6 MB per function
and minute of flight."""
_NO_TORQUE_Nm: Final = 2e-5
_NO_GAIN: Final = 1e-6
"""Practically zero; covariances stay regular."""
_WHITE_LAGS: Final = (1, 2, 5, 12)
"""Lags at which the autocorrelation of the innovations is reported, in steps of 40 ms: up to half a
second."""


@dataclass(frozen=True)
class Dependence:
    """Test of one function of states and inputs as a regressor of the innovations."""

    what: str  # ``CHANNEL on QUANTITY``
    log_likelihood_gain: float
    """Log-likelihood ratio of the model with the regressor over the model without it, nats."""
    penalty: float  # Gain above which the regressor is significant, nats
    change_counts: float = math.inf
    """Root mean square change of the 2 s open-loop prediction by the regressor, encoder counts, on the axis
    where it is largest; only for significant regressors."""

    @property
    def is_significant(self) -> bool:
        """Whether the gain exceeds the penalty."""
        return self.log_likelihood_gain > self.penalty

    @property
    def matters(self) -> bool:
        """Whether the regressor changes the prediction as much as an effect must that is named."""
        return self.change_counts >= thresholds.MATTERS_COUNTS


@dataclass(frozen=True)
class ResidualAnalysis:
    """Disturbances and innovations of the final model."""

    disturbances: DisturbanceModel  # Estimated disturbance torques about each axis
    gains: Floats
    """(3,): Log-likelihood ratio of the disturbances about each axis over no disturbance there, nats."""
    autocorrelation: Floats  # (l, 3): Autocorrelation of the innovations of each axis at the lags `lags_s`
    lags_s: tuple[float, ...]  # 40 ms to half a second
    bound: float  # Three standard deviations of the autocorrelation of white noise
    measurements: int  # Number of innovations of all axes
    dependences: tuple[Dependence, ...]
    """Significant regressors of the innovations; empty if the innovations are white. Regressors that matter
    come first, and the strongest of them before the others."""
    kicks: Mapping[str, Kicks] = field(default_factory=dict)  # Kicks by axis; empty if there are none
    thrust_gains: Floats = field(default_factory=lambda: np.zeros(0))
    """(g,): Log-likelihood ratio of each random variation of the thrust over none, nats; empty if the model
    has none."""

    @property
    def predictable_share(self) -> float:
        """Share of the innovations' variance that the strongest dependence predicts, 0 to 1."""
        gain = self.dependences[0].log_likelihood_gain if self.dependences else 0.0
        return 1.0 - math.exp(-2.0 * gain / self.measurements)

    @property
    def axis(self) -> str:
        """The axis with the most significant disturbances."""
        return AXES[int(np.argmax(self.gains))]


def residual_analysis(screenings: Sequence[Screening]) -> ResidualAnalysis:
    """Test the innovations of a model."""
    first = screenings[0]
    significant = sorted(
        (dependence for dependence in dependences(screenings) if dependence.is_significant),
        key=lambda dependence: (not dependence.matters, -dependence.log_likelihood_gain),
    )
    autocorrelation, bound = _autocorrelation(first)
    result = ResidualAnalysis(
        disturbances=first.estimate.disturbances,
        gains=disturbance_gains(first),
        autocorrelation=autocorrelation,
        lags_s=tuple(lag * BLOCK_s for lag in _WHITE_LAGS),
        bound=bound,
        measurements=sum(screening.measurements for screening in screenings),
        dependences=tuple(significant[:_MAX_CORRELATES]),
        kicks=kicks(first.filtered, first.estimate.disturbances),
        thrust_gains=gain_ratios(first),
    )
    for screening in screenings:
        screening.release()
    return result


def penalty(coefficients: int) -> float:
    """Return the gain that the best regressor rarely reaches if the innovations are white, nats."""
    return thresholds.DEPENDENCE_NATS + thresholds.DEPENDENCE_NATS_PER_COEFFICIENT * coefficients


def disturbance_gains(screening: Screening) -> Floats:
    """Return how much more likely the flights are with disturbances about an axis than without, in nats."""
    # The shape is (3,): a log-likelihood ratio for each axis.
    disturbances = screening.estimate.disturbances
    calm_axes = [
        replace(
            disturbances,
            fast_std=np.where(is_axis, _NO_TORQUE_Nm, disturbances.fast_std),
            slow_std=np.where(is_axis, _NO_TORQUE_Nm, disturbances.slow_std),
        )
        for is_axis in np.eye(3, dtype=bool)
    ]
    return _ratios_over(screening.filtered, disturbances, calm_axes)


def gain_ratios(screening: Screening) -> Floats:
    """Return how much more likely the flights are if a gain varies at random than if it does not, in nats."""
    # The shape is (g,): a log-likelihood ratio for each random variation of the thrust.
    disturbances = screening.estimate.disturbances
    gains = disturbances.gains
    without_one_gain = [
        replace(disturbances, gains=(*gains[:i], replace(gains[i], std=_NO_GAIN), *gains[i + 1 :]))
        for i in range(len(gains))
    ]
    return _ratios_over(screening.filtered, disturbances, without_one_gain)


def _ratios_over(
    filtered: InnovationsModel, disturbances: DisturbanceModel, others: Sequence[DisturbanceModel]
) -> Floats:
    """Return the log-likelihood ratios of the disturbances over each of some `others`, nats."""
    if not others:
        return np.zeros(0)
    residuals = filtered.perturbed_residual()
    log_likelihoods = filtered.log_likelihoods([disturbances, *others], residuals).sum(axis=1)
    ratios: Floats = log_likelihoods[0] - log_likelihoods[1:]
    return ratios


def _autocorrelation(screening: Screening) -> tuple[Floats, float]:
    """Compute the autocorrelation of the innovations of all flights, shape (lags, 3), and its bound for white
    noise, three standard errors.
    """
    innovations = screening.filtered.innovations(screening.estimate.disturbances)
    innovation = np.concatenate([flight[:, 0] for flight in innovations.flights]).reshape(-1, 3)
    variance = np.maximum((innovation**2).mean(axis=0), 1e-12)
    correlations = [
        (innovation[lag:] * innovation[:-lag]).mean(axis=0) / variance
        for lag in _WHITE_LAGS
        if lag < len(innovation)
    ]
    return np.array(correlations), float(3.0 / np.sqrt(len(innovation)))


def dependences(screenings: Sequence[Screening]) -> list[Dependence]:
    """Test functions of states and inputs as regressors of the innovations of all flights."""
    # The coefficients of a function are the same in all flights; free parameters are projected out of each.
    linearised_flights = [
        linear for screening in screenings for linear in screening.filtered.linearised_flights
    ]
    splines = [
        candidate
        for candidate in spline_candidates(linearised_flights, _TEST_SPLINES)
        if channel_kind(candidate.dependence.channel) != "measurement"
    ]
    quantities = [quantity_values(linear.model.source, linear.trajectory) for linear in linearised_flights]
    scales = {name: _scale([values[name] for values in quantities]) for name in _PRODUCTS}
    first_flight = linearised_flights[0]
    functions = _dependence_functions(quantities, scales, first_flight.trajectory.step_s)
    rest_nats = _rest_nats(scales, first_flight.reference.record.resolution)
    tests = [_Test(" on ".join(spline.dependence), coefficient_std(spline), spline) for spline in splines]
    # `curves` has an array per flight, one column per coefficient of the function.
    tests += [
        _Test(f"torque.{axis} on {name}", np.full(curves[0].shape[1], std_Nm), curves)
        for name, curves in functions.items()
        for axis, std_Nm in zip(AXES, _TORQUE_STD_Nm, strict=True)
    ]
    # One list per set of flights, in the order of the tests.
    statistics_by_screening = []
    first_index = 0
    for screening in screenings:
        # `functions` has the curves of all flights, one set of flights after the other.
        flights = slice(first_index, first_index + len(screening.filtered.linearised_flights))
        curves_by_name = {name: curves[flights] for name, curves in functions.items()}
        statistics_by_screening.append(
            [*screening.spline_information(splines), *_function_statistics(screening, curves_by_name)]
        )
        first_index = flights.stop
    functions_tested = [
        _dependence(test, rest_nats.get(test.name, 0.0), statistics)
        for test, *statistics in zip(tests, *statistics_by_screening, strict=True)
    ]
    significant = [function for function in functions_tested if function.dependence.is_significant]
    result = [function.dependence for function in functions_tested if not function.dependence.is_significant]
    for together in batches(significant, lambda _: 1, _SIMULATED_TOGETHER):
        counts = _change_counts(together, screenings)
        result += [
            replace(function.dependence, change_counts=change_counts)
            for function, change_counts in zip(together, counts, strict=True)
        ]
    return sorted(result, key=lambda dependence: -dependence.log_likelihood_gain)


class _Test(NamedTuple):
    """A test of one function of states and inputs."""

    name: str  # ``CHANNEL on QUANTITY``
    prior_std: Floats  # (g,): Prior standard deviations of its coefficients
    source: Candidate | list[Floats]  # (n, g): Spline term, or the curves of a torque in each flight


class _TestedFunction(NamedTuple):
    """Result of a test, and the coefficients with which the function fits best."""

    test: _Test
    dependence: Dependence
    coefficients: Floats  # (g,)

    def rates(self, regressors: Regressors, flight: int) -> Floats:
        """Return what the function adds to the rates of the states of a flight, (n, states); `flight` is its
        number among the flights of all sets.
        """
        if isinstance(self.test.source, Candidate):
            return np.asarray(regressors.spline_signals(self.test.source).rates @ self.coefficients)
        channel, _, _ = self.test.name.partition(" on ")
        axis = AXES.index(channel_place(channel))
        torque_Nm = self.test.source[flight] @ self.coefficients
        return np.asarray(regressors.linear.steps.by_disturbance[:, :, axis] * torque_Nm[:, None])


def _dependence(test: _Test, rest_nats: float, statistics: Sequence[ScoreStatistics]) -> _TestedFunction:
    """Carry out a test with one coefficient vector for all flights; `statistics` has one entry per set. It
    needs `rest_nats` more gain, because it may imitate an encoder that repeats its count.
    """
    information = np.sum([of_set.information for of_set in statistics], axis=0)
    score = np.sum([of_set.score for of_set in statistics], axis=0)
    gain, coefficients, _ = score_of(information, score, test.prior_std)
    dependence = Dependence(test.name, gain, penalty(len(test.prior_std)) + rest_nats)
    return _TestedFunction(test, dependence, coefficients)


def _change_counts(functions: Sequence[_TestedFunction], screenings: Sequence[Screening]) -> list[float]:
    """Return the change of the open-loop prediction by each of k functions, encoder counts."""
    # It is the root mean square over the set of flights, and on the axis, where it is largest.
    changes, flight = [], 0
    for screening in screenings:
        squares, rows = np.zeros((len(AXES), len(functions))), 0
        for regressors in screening.regressors:
            rates = np.stack([function.rates(regressors, flight) for function in functions], axis=2)
            of_flight = open_loop_squares(regressors.linear, rates)
            squares, rows, flight = squares + of_flight.squares, rows + of_flight.rows, flight + 1
        changes.append(np.sqrt(squares / max(rows, 1)).max(axis=0))
    return [float(change) for change in np.max(changes, axis=0)]


def _function_statistics(
    screening: Screening, functions: Mapping[str, list[Floats]]
) -> list[ScoreStatistics]:
    """Return the score statistics of each function as a torque about elevation, pitch and travel."""
    # `functions` has the curves of each flight, shape (n, s), by name. The order is that of the functions,
    # and of the axes for each function.
    result: list[ScoreStatistics] = []
    for batch in batches(functions.values(), lambda curves: curves[0].shape[1], screening.batch):
        sizes = [curves[0].shape[1] for curves in batch]
        torques_Nm = [np.hstack(flight_curves) for flight_curves in zip(*batch, strict=True)]
        statistics_by_axis = [
            screening.projected(
                screening.filtered.disturbance_regressors(screening.estimate.disturbances, axis, torques_Nm),
                sizes,
            )
            for axis in range(len(AXES))
        ]
        for function_statistics in zip(*statistics_by_axis, strict=True):
            result.extend(function_statistics)
    return result


def _rest_nats(scales: Mapping[str, _Scale], count_rad: Floats) -> dict[str, float]:
    """Return the additional gain that a dependence of a torque on a rate near rest, or on the rate of its own
    axis, needs, by its name [nats]. Shapes: `count_rad` (3,).
    """
    result = {
        f"torque.{axis} on {rate} near rest": thresholds.NEAR_REST_NATS for axis in AXES for rate in _RATES
    }
    for axis, axis_count_rad in zip(AXES, count_rad, strict=True):
        name = f"{axis}_rate"
        rest_rate = max(_REST_WIDTHS) * scales[name].std
        is_resolved = rest_rate * BLOCK_s > thresholds.RESOLVED_REST_COUNTS * axis_count_rad
        result[f"torque.{axis} on {name}"] = thresholds.NEAR_REST_NATS
        if not is_resolved:
            result[f"torque.{axis} on {name} near rest"] = thresholds.UNRESOLVED_REST_NATS
    return result


def correlates(splines: Sequence[ScoredCandidate]) -> list[str]:
    """Name the dependences with the best scores."""
    best = splines[0].log_likelihood_gain if splines else 0.0
    min_gain = max(thresholds.CORRELATE_SHARE * best, thresholds.CHANCE_NATS)
    return [
        " on ".join(spline.candidate.dependence)
        for spline in splines[:_MAX_CORRELATES]
        if spline.log_likelihood_gain > min_gain
    ]


_CELLS: Final = 8
"""Cells along each quantity: with fewer, regions blur; with more, cells are visited too briefly."""
_VISITED_s: Final = 0.6
"""Time in a cell below which it is not tested: a correlation time of fast disturbances."""
_TAIL_SHARE: Final = 0.01
"""Share of the flight beyond each end of the cells; it counts into the outermost cells."""
_MOTION: Final = (*AXES, *(f"{axis}_rate" for axis in AXES))
"""Quantities of a plane that a reader can picture: where the arm is and how fast it turns."""
_PLANES: Final = (*_MOTION, "thrust", "thrust_difference")
"""Quantities that a plane may have if a cause is known to depend on them."""


@dataclass(frozen=True)
class PlaneTrajectory:
    """One flight in the plane of the two quantities."""

    x: Floats  # x, y: (n,): The quantities every 40 ms, in SI units
    y: Floats
    torque_Nm: Floats  # (n,): Torque about the axis that the model lacks, less its mean


@dataclass(frozen=True)
class RegionTest:
    """Tests of all cells for one model."""

    z: Floats
    """(cells, cells): Score of each cell in standard deviations, x along the first index; nan if the flights
    were there too briefly."""
    fails: Booleans  # (cells, cells): Cells in which the model fails
    share: float  # Share of the flight time in these cells, 0 to 1
    rms_Nm: float  # Root mean square of the torque about the axis that the model lacks
    flights: tuple[PlaneTrajectory, ...]  # The flights in the plane


@dataclass(frozen=True)
class FailingRegions:
    """Regions in which a model fails, before and after it was extended."""

    axis: str  # Axis of the missing torque
    x: str  # x, y: Names of the two quantities of the plane, keys of `QUANTITIES`
    y: str
    x_edges: Floats  # x_edges, y_edges: (cells + 1,): Edges of the cells, in SI units
    y_edges: Floats
    before: RegionTest  # before, after: Tests of the model before and after the extension
    after: RegionTest


def failing_regions(before: Estimate, after: Estimate, axis: str, first: str = "") -> FailingRegions:
    """Find the plane in which the model fails most clearly, and test its cells before and after the
    extension.
    """
    # `first` is the quantity that a cause is known to depend on; if it is empty, the flights choose it.
    # Before the extension, disturbances explain what is missing: test against those that remain after it.
    screening = Screening(replace(before, disturbances=after.disturbances))
    values = _plane_values(screening)
    if first not in _PLANES:
        # The first quantity is the one along which the model fails most clearly.
        line_evidence = {
            name: _evidence(screening, axis, _cells_along(values[name]), _CELLS) for name in _MOTION
        }
        first = max(line_evidence, key=lambda name: line_evidence[name])
    plane_evidence = {}
    for name in _MOTION:
        if name != first:
            # Number of the cell in the plane: row times cells of a row, plus column.
            cells = _cells_along(values[first]) * _CELLS + _cells_along(values[name])
            plane_evidence[name] = _evidence(screening, axis, cells, _CELLS**2)
    second = max(plane_evidence, key=lambda name: plane_evidence[name])
    edges = {name: _cell_edges(values[name]) for name in (first, second)}
    test_before = _test_cells(screening, before, axis, first, second, edges)
    screening.release()
    test_after = _test_cells(Screening(after), after, axis, first, second, edges)
    return FailingRegions(
        axis,
        x=first,
        y=second,
        x_edges=edges[first],
        y_edges=edges[second],
        before=test_before,
        after=test_after,
    )


def _plane_values(screening: Screening) -> dict[str, Floats]:
    """Return the quantities of `_PLANES` at all steps of all flights, shape (n,), by name."""
    values_by_flight = [
        quantity_values(linear.model.source, linear.trajectory)
        for linear in screening.filtered.linearised_flights
    ]
    return {name: np.concatenate([values[name] for values in values_by_flight]) for name in _PLANES}


def _cell_edges(values: Floats) -> Floats:
    """Return the edges of the cells along a quantity, shape (cells + 1,)."""
    low, high = np.quantile(values, [_TAIL_SHARE, 1.0 - _TAIL_SHARE])
    return np.linspace(low, max(high, low + 1e-9), _CELLS + 1)


def _cells_along(values: Floats) -> Integers:
    """Divide the range of a quantity into cells, and return the cell number of each value, shape (n,)."""
    return _cell_number(values, _cell_edges(values))


def _evidence(screening: Screening, axis: str, cell: Integers, count: int) -> float:
    """Return the evidence that a model fails in some of `count` cells; `cell` is that of each step, (n,)."""
    # The sum of z^2 - 1 over all cells has the mean 0 if the model is right. It is divided by the root of the
    # number of visited cells, so that planes with different numbers can be compared.
    score = _cell_scores(screening, axis, cell, count)
    return float(np.nansum(score**2 - 1.0) / np.sqrt(max(1, np.isfinite(score).sum())))


def _cell_number(values: Floats, edges: Floats) -> Integers:
    """Return the number, 0 to `_CELLS` - 1, of the cell between `edges` of each value, shape (n,)."""
    return np.clip(np.searchsorted(edges, values, side="right") - 1, 0, _CELLS - 1)


def _cell_scores(screening: Screening, axis: str, cell: Integers, count: int) -> Floats:
    """Return the score of a torque in each of `count` cells in standard deviations, shape (count,)."""
    # `cell` is the cell of each step, (n,). The score is nan if the flights were in the cell too briefly.
    step_s = screening.filtered.linearised_flights[0].trajectory.step_s
    visited = np.nonzero(np.bincount(cell, minlength=count) * step_s >= _VISITED_s)[0]
    z = np.full(count, np.nan)
    flight_ends = np.cumsum([linear.rows for linear in screening.filtered.linearised_flights])[:-1]
    for first in range(0, len(visited), screening.batch):
        batch = visited[first : first + screening.batch]
        is_inside = np.asarray(cell[:, None] == batch[None, :], float)
        regressors = screening.filtered.disturbance_regressors(
            screening.estimate.disturbances, AXES.index(axis), np.split(is_inside, flight_ends)
        )
        statistics = screening.projected(regressors, [1] * len(batch))
        # Each cell has one regressor.
        z[batch] = [score[0] / np.sqrt(max(information[0, 0], 1e-12)) for information, score in statistics]
    return z


def _test_cells(
    screening: Screening, estimate: Estimate, axis: str, x: str, y: str, edges: Mapping[str, Floats]
) -> RegionTest:
    """Test all cells of a plane about an estimate, with the false discovery rate controlled."""
    values = _plane_values(screening)
    cell = _cell_number(values[x], edges[x]) * _CELLS + _cell_number(values[y], edges[y])
    z = _cell_scores(screening, axis, cell, _CELLS**2)
    tested = np.nonzero(np.isfinite(z))[0]
    fails = np.zeros(_CELLS**2, bool)
    # Two-sided p-values of standard normal scores.
    p_values = np.array([math.erfc(abs(score) / math.sqrt(2.0)) for score in z[tested]])
    fails[tested] = adjusted_p_values(p_values) <= FALSE_DISCOVERY_RATE
    trajectories = _plane_trajectories(screening, estimate, axis, x, y)
    missing_Nm = np.concatenate([trajectory.torque_Nm for trajectory in trajectories])
    return RegionTest(
        z=z.reshape(_CELLS, _CELLS),
        fails=fails.reshape(_CELLS, _CELLS),
        share=float(fails[cell].mean()),
        rms_Nm=float(np.sqrt(np.mean(missing_Nm**2))),
        flights=trajectories,
    )


def adjusted_p_values(p_values: Floats) -> Floats:
    """Adjust p-values so that a limit on them controls the false discovery rate (Benjamini and Hochberg).
    Shapes: `p_values` (k,).
    """
    # The result equals that of ``scipy.stats.false_discovery_control``, but to import scipy.stats takes half
    # a second of CPU time.
    count = len(p_values)
    order = np.argsort(p_values)
    scaled = p_values[order] * (count / np.arange(1, count + 1))
    adjusted = np.empty(count)
    adjusted[order] = np.minimum.accumulate(scaled[::-1])[::-1]
    return np.minimum(adjusted, 1.0)


def _plane_trajectories(
    screening: Screening, estimate: Estimate, axis: str, x: str, y: str
) -> tuple[PlaneTrajectory, ...]:
    """Return each flight in the plane of the quantities `x` and `y`, with the missing torque about `axis`."""
    flights = screening.filtered.linearised_flights
    missing = smoothed_disturbances(screening.filtered, estimate.disturbances)
    trajectories = []
    for flight, missing_torques in zip(flights, missing, strict=True):
        # The smoother has torques only at the rows that the filter compared with measurements.
        rows = np.concatenate([blocks.rows for blocks in flight.blocks])
        quantities = quantity_values(flight.model.source, flight.trajectory)
        torque_Nm = missing_torques.values[:, AXES.index(axis)]
        trajectories.append(
            PlaneTrajectory(
                x=quantities[x][rows], y=quantities[y][rows], torque_Nm=torque_Nm - torque_Nm.mean()
            )
        )
    return tuple(trajectories)

"""Rig parameters from weighings, balances, swings and readings of thrust; the TOML table of these tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, NamedTuple

import casadi as ca
import numpy as np
from heli_host.data.arrays import Floats

from heli_sim.errors import RigError
from heli_sim.model import MultibodyModel
from heli_sim.model.effect import AXES
from heli_sim.rig import Number, Rig

SCALE_N: Final = 0.00981
"""Smallest step of the scale that thrust is read from: a gram."""
_TYPICAL_BALANCE_deg: Final = -20.0
"""Elevation at which the search for the balance begins: that of the published rig is -22 degrees."""


@dataclass(frozen=True)
class Line:
    """Thrust = gain (V - dead zone)."""

    gain_N_per_V: float  # gain_N_per_V, gain_half: Slope, and half its 95 % interval
    gain_half: float
    dead_zone_V: float
    """dead_zone_V, dead_zone_half: Voltage at which the line is zero, and half its 95 % interval."""
    dead_zone_half: float


@dataclass(frozen=True)
class ThrustCurve:
    """Readings of a thrust stand: `thrust_N` of the front and the back rotor at `volts_V`, both
    shape (n, 2).
    """

    volts_V: Floats
    thrust_N: Floats

    def line(self) -> Line:
        """Fit the straight line to the readings above zero."""
        # The intervals come from the scatter of the readings, or from the step of the scale if that is
        # larger. A RigError when there are fewer than three readings.
        is_above_zero = self.thrust_N > 0.0
        volts_V, thrust_N = self.volts_V[is_above_zero], self.thrust_N[is_above_zero]
        if volts_V.size < 3:
            raise RigError(
                f"{volts_V.size} readings of thrust above zero are too few for a line",
                "read the scale at three voltages or more above the dead zone",
            )
        design = np.column_stack((volts_V, np.ones_like(volts_V)))
        (slope_N_per_V, intercept_N), *_ = np.linalg.lstsq(design, thrust_N, rcond=None)
        scatter_N = np.std(thrust_N - design @ (slope_N_per_V, intercept_N), ddof=2)
        # The error of rounding to the step of the scale has a standard deviation of step / sqrt(12).
        noise_N = max(float(scatter_N), SCALE_N / np.sqrt(12.0))
        covariance = noise_N**2 * np.linalg.inv(design.T @ design)
        dead_zone_V = -intercept_N / slope_N_per_V
        # Derivatives of the dead zone by slope and intercept, by which their covariance becomes its variance.
        zero_gradient = np.array([-dead_zone_V / slope_N_per_V, -1.0 / slope_N_per_V])
        # Half of a 95 % interval is two standard deviations.
        return Line(
            gain_N_per_V=float(slope_N_per_V),
            gain_half=2.0 * float(np.sqrt(covariance[0, 0])),
            dead_zone_V=float(dead_zone_V),
            dead_zone_half=2.0 * float(np.sqrt(zero_gradient @ covariance @ zero_gradient)),
        )


OFF: Final = 2.0
"""Difference of a reading from the fitted rig, in tolerances, from which it is reported as suspicious.

By chance, one reading in 20 differs by more than 1, and one in 15,000 by more than 2. With a higher limit, a
wrong reading or a missing term of the model would not be noticed.
"""
_MAX_SHARE_LEARNED: Final = 0.95
"""Largest ratio of the new to the old tolerance with which a parameter counts as determined by the tests."""
_MAX_ITERATIONS: Final = 30


@dataclass(frozen=True)
class Thrust:
    """Readings of a scale under the rotors, motors running."""

    curve: ThrustCurve  # Voltages and thrusts of both rotors
    scale_N: float = SCALE_N  # Smallest step of the scale


@dataclass(frozen=True)
class Balance:
    """Angle at which the free arm rests, with the motors off and the short arm level."""

    elevation_deg: float  # elevation_deg, tolerance_deg: The angle, and the half width of its 95 % interval
    tolerance_deg: float = 0.5


@dataclass(frozen=True)
class Swing:
    """Free swings of one axis about its rest position, with the motors off and the other two axes held."""

    axis: str  # ``elevation`` or ``pitch``
    swings: int  # Full periods that were timed
    seconds: float  # seconds, tolerance_s: Time of all these periods, and the half width of its 95 % interval
    from_deg: float  # from_deg, to_deg: Amplitude before the first and after the last of them
    to_deg: float
    tolerance_s: float = 0.3
    tolerance_deg: float = 0.5  # Half width of the 95 % interval of each amplitude
    elevation_deg: float = 0.0  # Elevation at which the long arm is held while pitch swings

    @property
    def decrement(self) -> float:
        """Logarithmic decrement: the logarithm of the ratio of two amplitudes that are one period apart."""
        return float(np.log(self.from_deg / self.to_deg) / self.swings)

    @property
    def decrement_tolerance(self) -> float:
        """Half the width of the 95 % interval of the decrement."""
        relative = np.hypot(self.tolerance_deg / self.from_deg, self.tolerance_deg / self.to_deg)
        return float(relative / self.swings)


@dataclass(frozen=True)
class Tested:
    """A reading, and its prediction by the model of the rig."""

    what: str  # what, unit: The reading in words, and its unit
    unit: str
    read: float  # read, tolerance: The reading, and the half width of its 95 % interval
    tolerance: float
    before: float  # before, after: Prediction with the parameters before and after the fit
    after: float

    @property
    def off(self) -> float:
        """Distance of the reading from the prediction by the fitted rig, in tolerances."""
        return abs(self.after - self.read) / self.tolerance


@dataclass(frozen=True)
class Weighed:
    """A rig after its bench tests."""

    rig: Rig  # The rig with the estimated parameters, their tolerances and sources
    determined: tuple[str, ...]
    """Names of the parameters that the tests determine: their tolerance is reduced, or they change by more
    than their tolerance."""
    tested: tuple[Tested, ...]  # All readings with their predictions


def weigh(
    rig: Rig, thrust: Thrust | None = None, balance: Balance | None = None, swings: Sequence[Swing] = ()
) -> Weighed:
    """Estimate rig parameters from those bench tests that were made."""
    if thrust is None and balance is None and not swings:
        raise RigError("no bench test is given", "give at least one of [thrust], [balance] and [[swing]]")
    weighed = Weighed(rig, (), ())
    if thrust is not None:
        weighed = _with_thrust(rig, thrust)
    if balance is not None or swings:
        by_masses = _with_masses(weighed.rig, balance, swings)
        weighed = Weighed(
            by_masses.rig,
            determined=(*weighed.determined, *by_masses.determined),
            tested=(*weighed.tested, *by_masses.tested),
        )
    return weighed


def _with_thrust(rig: Rig, thrust: Thrust) -> Weighed:
    """Set gain and dead zone of a rig by the thrust test."""
    line = thrust.curve.line()
    volts = thrust.curve.volts_V
    source = f"bench: line through thrust on a scale at {np.unique(volts).size} voltages"
    numbers = {
        "thrust_gain": _measured_number(rig, "thrust_gain", line.gain_N_per_V, line.gain_half, source),
        "dead_zone": _measured_number(
            rig, "dead_zone", max(line.dead_zone_V, 0.0), line.dead_zone_half, source
        ),
    }
    after = replace(rig, numbers={**rig.numbers, **numbers})
    # Two standard deviations of the scale's rounding, or 2 % of the largest thrust.
    tolerance_N = max(2.0 * thrust.scale_N / np.sqrt(12.0), 0.02 * float(thrust.curve.thrust_N.max()))
    _, rotors = volts.shape
    sides = ("front", "back") if rotors == 2 else ("a rotor's",)
    tested = tuple(
        Tested(
            f"{side} thrust at {volt:g} V",
            "N",
            read=float(measured_N),
            tolerance=float(tolerance_N),
            before=_thrust_N(rig, volt),
            after=_thrust_N(after, volt),
        )
        for volts_V, readings_N in zip(volts, thrust.curve.thrust_N, strict=True)
        for side, volt, measured_N in zip(sides, map(float, volts_V), readings_N, strict=True)
    )
    return Weighed(after, tuple(numbers), tested)


def _thrust_N(rig: Rig, volts_V: float) -> float:
    """Return the thrust of a rotor at a voltage."""
    return rig["thrust_gain"].value * max(volts_V - rig["dead_zone"].value, 0.0)


def _measured_number(rig: Rig, name: str, value: float, tolerance: float, source: str) -> Number:
    return Number(float(value), rig[name].unit, float(tolerance), source)


class _Acceleration(NamedTuple):
    """Acceleration of an axis, with its derivatives."""

    value: float
    by_angle: float
    by_rate: float


class _BenchModel:
    """Predicts the readings of bench tests with the model of the rig."""

    def __init__(self, rig: Rig) -> None:
        model = MultibodyModel()
        x, p, locked = ca.SX.sym("x", 6), ca.SX.sym("p", len(model.parameters)), ca.SX.sym("l", 3)
        acceleration = model.dynamics(x, ca.SX.zeros(2), p, ca.SX(0), locked)[3:6]
        self._function = ca.Function("axes", [x, p, locked], [acceleration, ca.jacobian(acceleration, x)])
        self.names = model.parameter_names
        self.values: Floats = model.parameter_values(rig)

    def _acceleration_at_rest(self, p: Floats, axis: int, angles_rad: Floats) -> _Acceleration:
        """Return the acceleration of an axis at rest while the other axes are locked."""
        locked = np.ones(3)
        locked[axis] = 0.0
        state = np.concatenate((angles_rad, np.zeros(3)))
        acceleration, by_state = (np.array(result) for result in self._function(state, p, locked))
        return _Acceleration(
            value=float(acceleration[axis, 0]),
            by_angle=float(by_state[axis, axis]),
            by_rate=float(by_state[axis, 3 + axis]),
        )

    def balance_deg(self, p: Floats, near_deg: float) -> float:
        """Return the angle of equilibrium that is nearest to the reading, by Newton's method."""
        angles = np.array([np.deg2rad(near_deg), 0.0, 0.0])
        for _ in range(_MAX_ITERATIONS):
            acceleration = self._acceleration_at_rest(p, 0, angles)
            if acceleration.by_angle >= 0.0:
                raise RigError(
                    f"the arm of this rig does not balance near {near_deg:g} degrees: it falls there",
                    "look at L_theta and the masses, or leave [balance] out",
                )
            newton_step_rad = acceleration.value / acceleration.by_angle
            angles[0] -= newton_step_rad
            if abs(newton_step_rad) < 1e-12:
                break
        return float(np.rad2deg(angles[0]))

    def swing(self, p: Floats, swing: Swing) -> tuple[float, float]:
        """Return the time of all swings [s], and the logarithmic decrement per period."""
        axis = AXES.index(swing.axis)
        # Elevation swings about its balance, and pitch at the elevation at which the arm is held.
        elevation_deg = self.balance_deg(p, _TYPICAL_BALANCE_deg) if axis == 0 else swing.elevation_deg
        angles_rad = np.deg2rad([elevation_deg, 0.0, 0.0])
        _, by_angle, by_rate = self._acceleration_at_rest(p, axis, angles_rad)
        # Damped oscillation x'' = by_angle x + by_rate x': the square of its angular frequency.
        frequency2 = -by_angle - 0.25 * by_rate**2
        if frequency2 <= 0.0:
            raise RigError(f"{swing.axis} of this rig does not swing", "check its lengths and frictions")
        amplitude_rad = np.deg2rad(0.5 * (swing.from_deg + swing.to_deg))
        period_s = 2.0 * np.pi / np.sqrt(frequency2)
        # A pendulum is slower at large amplitudes, by the first term of its series.
        return swing.swings * period_s * (1.0 + amplitude_rad**2 / 16.0), -0.5 * by_rate * period_s


class _MassProblem:
    """Least-squares problem of masses and lengths. The tolerances of the rig are priors."""

    def __init__(self, rig: Rig, balance: Balance | None, swings: Sequence[Swing]) -> None:
        self._balance, self._swings, self._model = balance, swings, _BenchModel(rig)
        # Free are all numbers with a tolerance, but not the encoders' zeros, and not the thrust, which has
        # its own test.
        self.names = [
            name
            for name in self._model.names
            if rig[name].tolerance > 0.0
            and not name.startswith("offset")
            and name not in ("thrust_gain", "dead_zone")
        ]
        self._columns = [self._model.names.index(name) for name in self.names]
        self.mean: Floats = np.array([rig[name].value for name in self.names])
        self.tolerance: Floats = np.array([rig[name].tolerance for name in self.names])
        self.readings = _table_of_readings(balance, swings)
        self._measured = np.array([reading.value for reading in self.readings])
        self._reading_tolerance = np.array([reading.tolerance for reading in self.readings])

    def predict(self, values: Floats) -> Floats:
        """Return the predicted readings for the free parameters, in the order of `readings`."""
        p = self._model.values.copy()
        p[self._columns] = values
        predicted = []
        if self._balance is not None:
            predicted.append(self._model.balance_deg(p, self._balance.elevation_deg))
        for swing in self._swings:
            predicted += self._model.swing(p, swing)
        return np.array(predicted)

    def residuals(self, change: Floats) -> Floats:
        """Return the errors of readings and priors; `change` is that of the parameters, in tolerances."""
        error = self.predict(self.mean + change * self.tolerance) - self._measured
        return np.concatenate((error / self._reading_tolerance, change))


def _with_masses(rig: Rig, balance: Balance | None, swings: Sequence[Swing]) -> Weighed:
    """Estimate masses and lengths of a rig from balance and swings by least squares."""
    from scipy.optimize import least_squares

    problem = _MassProblem(rig, balance, swings)
    # Masses and lengths stay above 0. The unknowns are changes in units of the tolerances.
    low = [-np.inf if rig.may_be_negative(name) else 1e-6 * rig[name].value for name in problem.names]
    bounds = ((np.array(low) - problem.mean) / problem.tolerance, np.full(len(low), np.inf))
    fit = least_squares(problem.residuals, np.zeros(len(low)), bounds=bounds)
    # Readings and parameters are all scaled by 95 % tolerances, so that no factor 2 appears.
    posterior_share = np.sqrt(np.diag(np.linalg.inv(fit.jac.T @ fit.jac)))
    values = problem.mean + fit.x * problem.tolerance
    test_names = " and ".join(
        [
            *(["the angle of balance"] if balance else []),
            *dict.fromkeys(f"swings of {swing.axis}" for swing in swings),
        ]
    )
    # The tests determine a parameter if they reduce its tolerance, or move it beyond that.
    determined = tuple(
        name
        for name, share, change in zip(problem.names, posterior_share, fit.x, strict=True)
        if share < _MAX_SHARE_LEARNED or abs(change) > 1.0
    )
    numbers = dict(rig.numbers)
    # All parameters change, some only a little, because the tests were fitted to all of them together.
    for name, value, tolerance in zip(
        problem.names, values, posterior_share * problem.tolerance, strict=True
    ):
        source = f"bench: {test_names}, with {rig[name].source}"
        numbers[name] = _measured_number(rig, name, float(value), float(tolerance), source)
    after = replace(rig, numbers=numbers)
    predicted_before = problem.predict(problem.mean)
    predicted_after = problem.predict(np.array([after[name].value for name in problem.names]))
    tested = tuple(
        Tested(
            reading.name,
            reading.unit,
            read=reading.value,
            tolerance=reading.tolerance,
            before=float(before),
            after=float(after_fit),
        )
        for reading, before, after_fit in zip(
            problem.readings, predicted_before, predicted_after, strict=True
        )
    )
    return Weighed(after, determined, tested)


class _Reading(NamedTuple):
    """A reading of a bench test."""

    name: str
    unit: str
    value: float
    tolerance: float


def _table_of_readings(balance: Balance | None, swings: Sequence[Swing]) -> list[_Reading]:
    """Return all readings of the tests of masses and lengths."""
    readings = []
    if balance is not None:
        readings.append(_Reading("elevation of balance", "deg", balance.elevation_deg, balance.tolerance_deg))
    for swing in swings:
        swings_name = f"{swing.swings} swings of {swing.axis}"
        readings.append(_Reading(swings_name, "s", swing.seconds, swing.tolerance_s))
        decrement_name = f"decrement of {swing.axis}"
        readings.append(_Reading(decrement_name, "1", swing.decrement, swing.decrement_tolerance))
    return readings


BLANK: Final = "?"
"""A reading of the template that is not filled in yet."""
TEMPLATE: Final = """\
# Bench tests of a rig, for: heli-host rig weigh RIG THIS.toml --save-rig NEW.toml
# Write a number for each "?". Remove a table whose test was not done.
# Tolerances are half widths that hold the truth with 95 %.

# A scale under each rotor, the arm held; run the motors; read at three voltages or more.
[thrust]
volts_V = [2, 3, 4]
front_g = ["?", "?", "?"]
back_g = ["?", "?", "?"]
scale_g = 1

# Motors off, pitch level: where the arm stays in the air. Leave this out where it rests on the table.
[balance]
elevation_deg = "?"
tolerance_deg = 0.5

# Motors off, elevation and travel held: let pitch go, time whole swings, read the amplitude before and after.
[[swing]]
axis = "pitch"
swings = "?"
seconds = "?"
tolerance_s = 0.3
from_deg = "?"
to_deg = "?"
tolerance_deg = 0.5
"""


def bench_tests_from(table: Mapping[str, Any]) -> tuple[Thrust | None, Balance | None, list[Swing]]:
    """Read bench tests from a TOML `table`; docs/how-to/describe-your-rig.md shows one."""
    unknown = sorted(table.keys() - {"thrust", "balance", "swing"})
    if unknown:
        raise RigError(f"unknown bench test [{unknown[0]}]", "give [thrust], [balance] or [[swing]]")
    _refuse_blanks(table)
    thrust = _read_thrust_test(_subtable(table, "thrust")) if "thrust" in table else None
    balance = None
    if "balance" in table:
        balance = Balance(
            **_numbers_by_name(
                "[balance]", _subtable(table, "balance"), ("elevation_deg",), ("tolerance_deg",)
            )
        )
        _check_positive("[balance]", tolerance_deg=balance.tolerance_deg)
    swing_tables = table.get("swing", [])
    if not isinstance(swing_tables, list) or not all(isinstance(swing, dict) for swing in swing_tables):
        raise RigError("swing must be a list of tables", "write [[swing]] above each")
    return thrust, balance, [_read_swing_test(swing) for swing in swing_tables]


def _refuse_blanks(table: Mapping[str, Any]) -> None:
    """Refuse a table in which a reading of the template is still empty."""
    for name, value in table.items():
        table_name = f"[[{name}]]" if isinstance(value, list) else f"[{name}]"
        for entry in value if isinstance(value, list) else [value]:
            for key, reading in entry.items() if isinstance(entry, dict) else ():
                if BLANK in (reading if isinstance(reading, list) else [reading]):
                    raise RigError(
                        f"{table_name} {key} is not filled in yet",
                        f'write your reading in place of each "{BLANK}", or remove {table_name}',
                    )


def _read_thrust_test(table: Mapping[str, Any]) -> Thrust:
    """Read the thrust test: voltages [V] and readings of a scale [g] for one or both rotors."""
    allowed = {"volts_V", "front_g", "back_g", "scale_g"}
    if set(table) - allowed or "volts_V" not in table or not {"front_g", "back_g"} & set(table):
        raise RigError(
            "[thrust] needs volts_V, and front_g or back_g or both", f"give only {', '.join(sorted(allowed))}"
        )
    volts = _list_of_readings("volts_V", table["volts_V"])
    sides = [_list_of_readings(name, table[name]) for name in ("front_g", "back_g") if name in table]
    if any(len(side) != len(volts) for side in sides):
        raise RigError("[thrust] needs one reading per voltage", "give lists of the same length")
    scale_g = float(
        _numbers_by_name("[thrust]", {"scale_g": table.get("scale_g", 1.0)}, ("scale_g",), ())["scale_g"]
    )
    _check_positive("[thrust]", scale_g=scale_g)
    # If only one rotor was on the scale, both are assumed equal.
    grams = np.array([sides[0], sides[-1]]).T
    curve = ThrustCurve(np.repeat(np.array(volts)[:, None], 2, axis=1), grams * SCALE_N)
    if len(sides) == 1:
        curve = ThrustCurve(curve.volts_V[:, :1], curve.thrust_N[:, :1])
    return Thrust(curve, scale_g * SCALE_N)


def _read_swing_test(table: Mapping[str, Any]) -> Swing:
    """Read a swing test: the time of some swings [s], and the amplitudes before and after them [deg]."""
    axis = table.get("axis")
    if axis not in ("elevation", "pitch"):
        raise RigError(
            f"[[swing]] has axis = {axis!r}",
            'give "elevation" or "pitch", because travel has no rest position',
        )
    needed = ("swings", "seconds", "from_deg", "to_deg")
    optional = ("tolerance_s", "tolerance_deg", "elevation_deg")
    number_table = {name: value for name, value in table.items() if name != "axis"}
    numbers = _numbers_by_name("[[swing]]", number_table, needed, optional)
    swing = Swing(axis, swings=round(numbers.pop("swings")), **numbers)
    _check_positive(
        "[[swing]]",
        swings=swing.swings,
        seconds=swing.seconds,
        to_deg=swing.to_deg,
        tolerance_s=swing.tolerance_s,
        tolerance_deg=swing.tolerance_deg,
    )
    if swing.from_deg <= swing.to_deg:
        raise RigError(
            "[[swing]] has a growing amplitude",
            "give the larger amplitude as from_deg, before the timed swings",
        )
    return swing


def _subtable(table: Mapping[str, Any], name: str) -> Mapping[str, Any]:
    """Return a table within a `table`; a RigError if the entry is something else."""
    entry = table[name]
    if not isinstance(entry, dict):
        raise RigError(f"{name} is not a table", f"write [{name}] above its numbers")
    return entry


def _list_of_readings(name: str, value: object) -> list[float]:
    """Return a list of readings; a RigError if `value` is something else."""
    if not isinstance(value, list) or not value or not all(_is_number(number) for number in value):
        raise RigError(f"[thrust] {name} is not a list of numbers", "write it as [2, 4, 6]")
    return [float(number) for number in value]


def _numbers_by_name(
    table_name: str, table: Mapping[str, Any], needed: Sequence[str], optional: Sequence[str]
) -> dict[str, float]:
    """Return the numbers of a table by name; a RigError names a missing, unknown or invalid key."""
    for name in needed:
        if name not in table:
            raise RigError(f"{table_name} lacks {name}", "add it")
    for name, value in table.items():
        if name not in (*needed, *optional):
            raise RigError(f"{table_name} has no {name}", f"give only {', '.join((*needed, *optional))}")
        if not _is_number(value):
            raise RigError(f"{table_name} {name} = {value!r} is not a number", "give a number")
    return {name: float(value) for name, value in table.items()}


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and bool(np.isfinite(value))


def _check_positive(table_name: str, **values: float) -> None:
    """Raise a RigError for the first of the `values` that is not positive."""
    for name, value in values.items():
        if not value > 0.0:
            raise RigError(f"{table_name} {name} = {value:g} is not positive", "give a number above 0")

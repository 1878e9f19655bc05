"""Flights of the MuJoCo rig, as logs: by the flight code, and by three other controllers."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from heli_host.board.heli import Heli
from heli_host.board.rest_check import ANGLE_SHIFTED
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight
from heli_host.data.log.summary import FlightSummary
from heli_host.declaration import Fault
from heli_host.errors import FlightAborted
from heli_host.fly.plan import Plan
from heli_host.fly.runner import fly
from heli_host.fly.tracking import NOT_TRACKED
from heli_host.link.session import Session
from heli_sim.rig import Rig
from heli_sim.rig.rig import count_rad
from heli_sim.sil.inprocess import InProcessTransport
from heli_sim.sil.options import SilOptions
from heli_sim.sil.world import SilWorld
from scipy.linalg import solve_continuous_are

from heli_benchmark.plant import HiddenEffect, MujocoPlant

_TEXT = """
title = "Blind {name}"
[start]
elevation_deg = 0
rate_deg_s = 8
settle_s = 3
[[segment]]
kind = "sine"
travel_amplitude_deg = {travel}
travel_period_s = {travel_s}
elevation_amplitude_deg = {elevation}
elevation_period_s = {elevation_s}
duration_s = {sines_s}
excite = {{ signal = "multisine", front_V = 0.25, back_V = 0.25, start_Hz = 0.1, stop_Hz = 4 }}
[[segment]]
kind = "waypoints"
path = "straight"
points = [
  {{ at_s = 6, elevation_deg = 10, travel_deg = {corner} }},
  {{ at_s = 11, elevation_deg = -10, travel_deg = 0 }},
  {{ at_s = 16, elevation_deg = 4, travel_deg = -{corner} }},
  {{ at_s = 20, elevation_deg = -4, travel_deg = -20 }},
]
duration_s = {corners_s}
excite = {{ signal = "prbs", front_V = 0.25, back_V = 0.25, stop_Hz = 8, seed = {seed} }}
[[segment]]
kind = "hold"
duration_s = 1
"""


_TRAVEL_CHECKS_OFF = {"travel_motion_deg": 90.0, "travel_motion_s": 30.0, "travel_silence_s": 0.0}
"""With these parameters, the board does not take an arm that a hidden effect holds for an unplugged travel
encoder."""
# Shortest period per degree of amplitude, for which the sine stays below the board's 20 deg/s.
_MIN_PERIOD_s_per_deg = 0.605
_MAX_RATE_deg_s = 19.9


def plan(name: str, duration_s: float, rng: np.random.Generator) -> Plan:
    """Write a plan that excites each axis, different in each case."""
    corners_s = 22.0
    # 6 s remain for the start and the hold of `_TEXT`.
    sines_s = duration_s - corners_s - 6.0
    travel_deg = rng.uniform(25, 45)
    travel_s = max(round(rng.uniform(0.6, 0.75) * travel_deg, 1), _MIN_PERIOD_s_per_deg * round(travel_deg))
    # A sine that is shorter than its period fades in within half the segment. A smooth step of the amplitude
    # has a rate of at most 1.5 times its mean, which adds to that of the sine.
    fade_s = 0.5 * sines_s
    max_travel_deg = np.inf
    if fade_s < 0.5 * travel_s:
        sine_rate_deg_s = 2.0 * np.pi * round(travel_deg) / travel_s
        max_travel_deg = (_MAX_RATE_deg_s - sine_rate_deg_s) * fade_s / 1.5
    return Plan.parse(
        _TEXT.format(
            name=name,
            travel=min(round(travel_deg), max_travel_deg),
            travel_s=travel_s,
            elevation=round(rng.uniform(6, 10), 1),
            elevation_s=round(rng.uniform(7, 12), 1),
            sines_s=sines_s,
            corner=round(rng.uniform(25, 45)),
            corners_s=corners_s,
            seed=int(rng.integers(1, 1000)),
        ),
        f"{name}.toml",
    )


def _is_usable(summary: FlightSummary) -> bool:
    """Whether the log of a flight contains all of its plan."""
    return (
        summary.completed
        # Plans are drawn by chance, and the voltages are recorded: an axis that did not follow is no loss.
        or summary.outcome.startswith(NOT_TRACKED)
        # The encoders are healthy: a hidden effect has moved an angle at rest.
        or summary.outcome.startswith(ANGLE_SHIFTED)
        # The masses of Table 2 balance at -22 degrees and never touch the table.
        or Fault.LANDING_TIMEOUT.name.lower() in summary.outcome
    )


def flown(rig: Rig, hidden: Sequence[HiddenEffect], course: Plan, seed: int) -> Flight:
    """Fly a plan with the flight code behind the simulated line."""
    # MujocoPlant has the members of a Plant that SilWorld uses, no others.
    world = SilWorld(SilOptions(seed=seed), MujocoPlant(rig, hidden))  # type: ignore[arg-type]
    session = Session(InProcessTransport(world), session_number=1)
    session.connect()
    with tempfile.TemporaryDirectory() as folder, Heli(session) as heli:
        for name, value in _TRAVEL_CHECKS_OFF.items():
            heli.params[name] = value
        log = Path(folder) / "flight.mcap"
        summary = fly(heli, course, log_path=log)
        flight = read_flight(log)
    if not _is_usable(summary):
        raise FlightAborted(f"{course.title}: {summary.outcome}", "draw another seed")
    return flight


CONTROLLERS = ("cascade", "state_feedback", "soft")
_ELEVATION_AND_TRAVEL = [0, 2]
"""Indices of the angles that follow the reference."""
_PWM_STEPS = 2100
"""Steps of a driver that switches at 20 kHz; the voltages of a log are multiples of one."""
_FILTER_s = 0.03
_MAX_PITCH_rad, _MAX_ELEVATION_rad = 1.2, 0.42
_MAX_PITCH_REFERENCE_rad = 0.45


@dataclass(frozen=True)
class Route:
    """Reference motion and excitation of a flight."""

    duration_s: float  # Length of the flight
    travel_deg: float  # travel_deg, elevation_deg: Largest deflection to either side
    elevation_deg: float
    sines: bool  # Whether the reference is a sum of sines or a sequence of steps
    excitation_V: float  # Amplitude of the multisine added to each motor


def tracked(
    rig: Rig,
    nominal: Rig,
    hidden: Sequence[HiddenEffect],
    route: Route,
    *,
    controller: str,
    rate_Hz: int,
    rng: np.random.Generator,
) -> Flight:
    """Fly a route from a hover, by a controller that knows the nominal rig."""
    plant = MujocoPlant(rig, hidden)
    step_s, milliseconds_per_step = 1.0 / rate_Hz, 1000 // rate_Hz
    times_s: Floats = step_s * np.arange(round(route.duration_s * rate_Hz), dtype=np.float64)
    reference_rad = _reference_motion(route, times_s, rng)
    excitation_V = route.excitation_V * _multisine(times_s, rng)
    pilot = _Pilot(nominal, controller, step_s, rng)
    counts_rad = count_rad(rig)
    state = np.zeros(6)
    for effect in hidden:
        effect.rest(state)
    # The encoders count from 0 at power-up, so the controller takes the first angles for level.
    power_up_rad = state[:3].copy()
    encoder_rad = plant.encoder_angles_rad(state[:3])
    rows: Floats = np.empty((len(times_s), 5))  # Both voltages, then the three angles
    for k in range(len(times_s)):
        angles = np.round((encoder_rad - power_up_rad) / counts_rad) * counts_rad
        volts = pilot.volts(angles, reference_rad[k], excitation_V[k])
        rows[k] = (*volts, *angles)
        for _ in range(milliseconds_per_step):
            after, measured = plant.millisecond(state.tolist(), volts.tolist())
            state, encoder_rad = np.array(after), np.array(measured)
        if abs(state[1]) > _MAX_PITCH_rad or abs(state[0]) > _MAX_ELEVATION_rad:
            raise FlightAborted(f"at {times_s[k]:.1f} s an angle leaves its range", "draw another seed")
    return Flight(times_s, *np.ascontiguousarray(rows.T))


class _Pilot:
    """Controller that computes voltages from angles."""

    # Elevation is controlled by the mean of both voltages. Travel is controlled by pitch, and pitch by the
    # difference of the voltages. Rates are filtered differences of angles.

    def __init__(self, rig: Rig, controller: str, step_s: float, rng: np.random.Generator) -> None:
        # Values by the paper's names: masses M, lengths L, and g.
        v = {name: rig[name].value for name in rig}
        carried_kg = v["M_f"] + v["M_b"] + v["M_h"]
        inertia_e = carried_kg * v["L_a"] ** 2 + v["M_w"] * v["L_b"] ** 2 + v["M_l"] * v["L_x"] ** 2
        inertia_p = (v["M_f"] + v["M_b"]) * v["L_h"] ** 2 + carried_kg * v["L_phi"] ** 2
        weight_Nm = v["g"] * (carried_kg * v["L_a"] + v["M_l"] * v["L_x"] - v["M_w"] * v["L_b"])
        self._hover_V = weight_Nm / (2.0 * v["thrust_gain"] * v["L_a"]) + v["dead_zone"]
        self._V_per_elevation_rad_s2 = inertia_e / (2.0 * v["thrust_gain"] * v["L_a"])
        self._V_per_pitch_rad_s2 = inertia_p / (2.0 * v["thrust_gain"] * v["L_h"])
        self._travel_rad_s2_per_rad = weight_Nm / inertia_e
        self._lowest_V = -v["supply"] if v["reverse_thrust"] else 0.0
        self._highest_V = v["supply"]
        # A rig without a switching driver has an analog amplifier; 1 µV is as good as continuous.
        self._voltage_step_V = v["supply"] / _PWM_STEPS if v["driver_dead_band"] else 1e-6
        self._step_s = step_s
        speed_factor = 0.7 if controller == "soft" else 1.0
        self._elevation_gains = _elevation_controller_gains(controller, speed_factor * rng.uniform(1.6, 2.6))
        self._pitch_gains, self._travel_gains = _pitch_and_travel_controller_gains(
            controller,
            self._travel_rad_s2_per_rad,
            pitch_rad_s=speed_factor * rng.uniform(2.4, 3.4),
            travel_rad_s=rng.uniform(0.5, 0.8),
        )
        self._previous_rad: Floats | None = None
        self._rates = np.zeros(3)
        self._previous_reference_rad: Floats | None = None
        self._error_integrals = np.zeros(2)

    def volts(self, angles: Floats, reference_rad: Floats, excitation_V: Floats) -> Floats:
        """Return the front and the back voltage for the next step. Shapes: `angles` (3,), `reference_rad`
        (2,), `excitation_V` (2,).
        """
        previous_rad = angles if self._previous_rad is None else self._previous_rad
        self._previous_rad = angles
        newest_share = self._step_s / (_FILTER_s + self._step_s)
        self._rates = self._rates + newest_share * ((angles - previous_rad) / self._step_s - self._rates)
        previous_reference_rad = (
            reference_rad if self._previous_reference_rad is None else self._previous_reference_rad
        )
        self._previous_reference_rad = reference_rad
        reference_rad_s = (reference_rad - previous_reference_rad) / self._step_s
        # Elevation and travel follow the reference; pitch follows the controller of travel.
        _, pitch_rad, _ = angles
        _, pitch_rad_s, _ = self._rates
        error_rad = reference_rad - angles[_ELEVATION_AND_TRAVEL]
        rate_error = reference_rad_s - self._rates[_ELEVATION_AND_TRAVEL]
        # The integrals are limited, so that they do not grow while a voltage is at its limit.
        self._error_integrals = np.clip(self._error_integrals + error_rad * self._step_s, -1.0, 1.0)
        elevation_errors, travel_errors = np.stack((error_rad, rate_error, self._error_integrals), axis=1)
        elevation_rad_s2 = float(self._elevation_gains @ elevation_errors)
        pitch_reference_rad = float(
            np.clip(self._travel_gains @ travel_errors, -_MAX_PITCH_REFERENCE_rad, _MAX_PITCH_REFERENCE_rad)
        )
        pitch_gain, pitch_rate_gain = self._pitch_gains
        pitch_rad_s2 = pitch_gain * (pitch_reference_rad - pitch_rad) - pitch_rate_gain * pitch_rad_s
        mean_V = self._hover_V + self._V_per_elevation_rad_s2 * elevation_rad_s2
        difference_V = self._V_per_pitch_rad_s2 * pitch_rad_s2
        volts = np.array([mean_V + difference_V, mean_V - difference_V]) + excitation_V
        steps = np.round(np.clip(volts, self._lowest_V, self._highest_V) / self._voltage_step_V)
        return np.asarray(steps * self._voltage_step_V)


def _elevation_controller_gains(controller: str, bandwidth_rad_s: float) -> Floats:
    """Return the gains of elevation's error, its rate and its integral, in 1/s2, 1/s and 1/s3."""
    if controller == "state_feedback":
        # A chain of integrators that ends with the integral of the error.
        state_matrix = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
        state_weights = np.diag([bandwidth_rad_s**4, 0.5 * bandwidth_rad_s**2, 0.1 * bandwidth_rad_s**6])
        return _lqr_gains(state_matrix, np.array([[0.0], [1.0], [0.0]]), state_weights)
    # A damping ratio of 0.9, and a slow integral.
    return np.array([bandwidth_rad_s**2, 1.8 * bandwidth_rad_s, 0.3 * bandwidth_rad_s**3])


def _pitch_and_travel_controller_gains(
    controller: str, travel_rad_s2_per_rad: float, *, pitch_rad_s: float, travel_rad_s: float
) -> tuple[Floats, Floats]:
    """Return the gains of pitch and its rate, and those of travel's error, its rate and its integral. The
    arguments `pitch_rad_s` and `travel_rad_s` are the bandwidths of both loops.
    """
    if controller == "state_feedback":
        # The order of the states. Pitch accelerates travel, and the input accelerates pitch.
        pitch, pitch_rate, travel, travel_rate, travel_integral = range(5)
        state_matrix = np.zeros((5, 5))
        state_matrix[pitch, pitch_rate] = 1.0
        state_matrix[travel, travel_rate] = 1.0
        state_matrix[travel_rate, pitch] = travel_rad_s2_per_rad
        state_matrix[travel_integral, travel] = 1.0
        state_weights = np.diag([pitch_rad_s**4, 0.3 * pitch_rad_s**2, 40.0 * travel_rad_s**4, 40.0, 0.5])
        gains = _lqr_gains(state_matrix, np.array([[0.0], [1.0], [0.0], [0.0], [0.0]]), state_weights)
        pitch_gains, travel_gains = gains[:travel], gains[travel:]
        # Travel's errors make a reference of pitch, which the gain of pitch multiplies.
        return pitch_gains, travel_gains / gains[pitch]
    # A damping ratio of 0.9, and a slow integral.
    travel_gains = np.array([travel_rad_s**2, 1.8 * travel_rad_s, 0.1 * travel_rad_s**3])
    return np.array([pitch_rad_s**2, 1.8 * pitch_rad_s]), travel_gains / travel_rad_s2_per_rad


def _lqr_gains(a: Floats, b: Floats, state_weights: Floats) -> Floats:
    """Return the gains of the linear-quadratic regulator of x' = a x + b u, with weight 1 of the input u."""
    solution = solve_continuous_are(a, b, state_weights, np.eye(1))
    return np.asarray((b.T @ solution)[0])


def _reference_motion(route: Route, times_s: Floats, rng: np.random.Generator) -> Floats:
    """Draw the reference of elevation and travel, rad, which starts level and is smooth, shape (n, 2)."""
    reference_rad = np.zeros((len(times_s), 2))
    # Travel follows a reference that is twice as slow as that of elevation.
    for column, (most_deg, slowness) in enumerate(((route.elevation_deg, 1.0), (route.travel_deg, 2.0))):
        most_rad = np.deg2rad(most_deg)
        if route.sines:
            # A large slow sine and a small fast one.
            periods_s = slowness * rng.uniform(8.0, 14.0) / np.array([1.0, 1.7])
            phases = rng.uniform(-np.pi, np.pi, 2)
            sizes = most_rad * np.array([0.75, 0.25])
            wave = sizes * np.sin(2.0 * np.pi * times_s[:, None] / periods_s + phases)
            reference_rad[:, column] += wave.sum(axis=1)
        # 60 steps last longer than any flight. Together with sines they are smaller.
        at_s = np.cumsum(slowness * rng.uniform(3.0, 6.0, 60))
        levels_rad = most_rad * rng.uniform(-1.0, 1.0, 61) * (0.4 if route.sines else 1.0)
        levels_rad[0] = 0.0
        reference_rad[:, column] += levels_rad[np.searchsorted(at_s, times_s)]
    # Two lags each: no step remains, and the motion leads away from the hover. The second one is longer for
    # travel.
    step_s = times_s[1] - times_s[0]
    for lag_s in (0.4, np.array([0.4, 0.8])):
        decay = np.exp(-step_s / lag_s)
        lagging_rad = np.zeros(2)
        for row in range(len(reference_rad)):
            lagging_rad = decay * lagging_rad + (1.0 - decay) * reference_rad[row]
            reference_rad[row] = lagging_rad
    return reference_rad


def _multisine(times_s: Floats, rng: np.random.Generator) -> Floats:
    """Multisine from 0.1 to 4 Hz with random phases for each motor, peaks of about 1, shape (n, 2)."""
    lines_Hz = np.arange(0.1, 4.0, 0.15)
    phases = rng.uniform(-np.pi, np.pi, (len(lines_Hz), 2))
    phases_rad = 2.0 * np.pi * times_s[:, None, None] * lines_Hz[:, None] + phases
    return np.asarray(np.sin(phases_rad).sum(axis=1) / np.sqrt(1.5 * len(lines_Hz)))

"""Flights by other controllers than the flight code, at the rate of the log.

The log shows each voltage as it acted, so the controller runs at the rate of the log, 100 to 500 Hz. The rig
hovers when the log begins, as in most logs of other programs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from heli_host.arrays import Floats
from heli_host.errors import FlightAborted
from heli_host.flight import Flight
from heli_sim.rig import Rig
from heli_sim.rig.encoders import count_rad
from scipy.linalg import solve_continuous_are

from heli_benchmark.engine.plant import HiddenEffect, MujocoPlant

CONTROLLERS = ("cascade", "state_feedback", "soft")
_PWM_STEPS = 2100
"""Steps of a driver that switches at 20 kHz; the voltages of a log are multiples of one."""
_FILTER_s = 0.03
_MAX_PITCH_rad, _MAX_ELEVATION_rad = 1.2, 0.42


@dataclass(frozen=True)
class Route:
    """Reference motion and excitation of a flight.

    Parameters
    ----------
    duration_s : float
        Length of the flight.
    travel_deg, elevation_deg : float
        Largest deflection to either side.
    sines : bool
        Whether the reference is a sum of sines or a sequence of steps.
    excitation_V : float
        Amplitude of the multisine added to each motor.
    """

    duration_s: float
    travel_deg: float
    elevation_deg: float
    sines: bool
    excitation_V: float


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
    """Fly a route from a hover, by a controller that knows the nominal rig.

    Parameters
    ----------
    rig : Rig
        True numbers.
    nominal : Rig
        Parameters that the controller is designed for.
    hidden : sequence of HiddenEffect
        What is hidden.
    route : Route
        Reference motion.
    controller : str
        One of `CONTROLLERS`.
    rate_Hz : int
        Rows and controller steps per second; a divisor of 1000.
    rng : numpy.random.Generator
        Draws gains, places and phases.

    Returns
    -------
    Flight
        The voltages of a row act until the next row; angles are whole counts.

    Raises
    ------
    FlightAborted
        If the rig leaves the safe range of angles.
    """
    plant = MujocoPlant(rig, hidden)
    step_s, ticks = 1.0 / rate_Hz, 1000 // rate_Hz
    times_s: Floats = step_s * np.arange(round(route.duration_s * rate_Hz), dtype=np.float64)
    wanted = _places(route, times_s, rng)
    excited_V = route.excitation_V * _multisine(times_s, rng)
    pilot = _Pilot(nominal, controller, step_s, rng)
    counts_rad = count_rad(rig)
    state = np.zeros(6)
    for effect in hidden:
        effect.rest(state)
    # The controller takes the first angles for level.
    believed_rad = state[:3].copy()
    encoder_rad = plant.encoder_angles_rad(state[:3])
    rows: Floats = np.empty((len(times_s), 5))
    for k in range(len(times_s)):
        angles = np.round((encoder_rad - believed_rad) / counts_rad) * counts_rad
        volts = pilot.volts(angles, wanted[k], excited_V[k])
        rows[k] = (*volts, *angles)
        for _ in range(ticks):
            after, measured = plant.millisecond(state.tolist(), volts.tolist())
            state, encoder_rad = np.array(after), np.array(measured)
        if abs(state[1]) > _MAX_PITCH_rad or abs(state[0]) > _MAX_ELEVATION_rad:
            raise FlightAborted(f"at {times_s[k]:.1f} s an angle leaves its range", "draw another seed")
    return Flight(times_s, *np.ascontiguousarray(rows.T))


class _Pilot:
    """Voltages from angles: rates by filtered differences, gains from the nominal rig."""

    def __init__(self, rig: Rig, controller: str, step_s: float, rng: np.random.Generator) -> None:
        v = {name: rig[name].value for name in rig}
        carried_kg = v["M_f"] + v["M_b"] + v["M_h"]
        inertia_e = carried_kg * v["L_a"] ** 2 + v["M_w"] * v["L_b"] ** 2 + v["M_l"] * v["L_x"] ** 2
        inertia_p = (v["M_f"] + v["M_b"]) * v["L_h"] ** 2 + carried_kg * v["L_phi"] ** 2
        weight_Nm = v["g"] * (carried_kg * v["L_a"] + v["M_l"] * v["L_x"] - v["M_w"] * v["L_b"])
        self._hover_V = weight_Nm / (2.0 * v["thrust_gain"] * v["L_a"]) + v["dead_zone"]
        self._V_per_lift = inertia_e / (2.0 * v["thrust_gain"] * v["L_a"])
        self._V_per_roll = inertia_p / (2.0 * v["thrust_gain"] * v["L_h"])
        self._swing_per_rad = weight_Nm / inertia_e
        self._lowest_V = -v["supply"] if v["reverse_thrust"] else 0.0
        self._highest_V = v["supply"]
        self._whole_V = v["supply"] / _PWM_STEPS if v["driver_dead_band"] else 1e-6
        self._step_s = step_s
        soft = 0.7 if controller == "soft" else 1.0
        self._lift = _lift_gains(controller, soft * rng.uniform(1.6, 2.6))
        self._roll = _roll_gains(
            controller, self._swing_per_rad, soft * rng.uniform(2.4, 3.4), rng.uniform(0.5, 0.8)
        )
        self._before: Floats | None = None
        self._rates = np.zeros(3)
        self._wanted_before: Floats | None = None
        self._sums = np.zeros(2)

    def volts(self, angles: Floats, wanted: Floats, excited_V: Floats) -> Floats:
        """Return front and back voltage; `wanted` is elevation and travel."""
        before = angles if self._before is None else self._before
        self._before = angles
        share = self._step_s / (_FILTER_s + self._step_s)
        self._rates = self._rates + share * ((angles - before) / self._step_s - self._rates)
        wanted_before = wanted if self._wanted_before is None else self._wanted_before
        self._wanted_before = wanted
        speed = (wanted - wanted_before) / self._step_s
        off = wanted - angles[[0, 2]]
        slow = speed - self._rates[[0, 2]]
        self._sums = np.clip(self._sums + off * self._step_s, -1.0, 1.0)
        lift = float(self._lift @ [off[0], slow[0], self._sums[0]])
        lean = self._roll[2:] @ [off[1], slow[1], self._sums[1]]
        lean = float(np.clip(lean, -0.45, 0.45))
        roll = self._roll[0] * (lean - angles[1]) - self._roll[1] * self._rates[1]
        both_V = self._hover_V + self._V_per_lift * lift
        apart_V = self._V_per_roll * roll
        volts = np.array([both_V + apart_V, both_V - apart_V]) + excited_V
        steps = np.round(np.clip(volts, self._lowest_V, self._highest_V) / self._whole_V)
        return np.asarray(steps * self._whole_V)


def _lift_gains(controller: str, bandwidth_rad_s: float) -> Floats:
    """Gains of elevation's error, its rate and its integral, in 1/s2, 1/s and 1/s3."""
    if controller == "state_feedback":
        # A chain of integrators that ends with the integral of the error.
        a = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.0, 0.0]])
        weights = np.diag([bandwidth_rad_s**4, 0.5 * bandwidth_rad_s**2, 0.1 * bandwidth_rad_s**6])
        return _optimal(a, np.array([[0.0], [1.0], [0.0]]), weights)
    return np.array([bandwidth_rad_s**2, 1.8 * bandwidth_rad_s, 0.3 * bandwidth_rad_s**3])


def _roll_gains(controller: str, swing: float, pitch_rad_s: float, travel_rad_s: float) -> Floats:
    """Gains of pitch and its rate; of travel's error, its rate and its integral for the pitch wanted."""
    if controller == "state_feedback":
        a = np.zeros((5, 5))
        a[0, 1], a[2, 3], a[3, 0], a[4, 2] = 1.0, 1.0, swing, 1.0
        weights = np.diag([pitch_rad_s**4, 0.3 * pitch_rad_s**2, 40.0 * travel_rad_s**4, 40.0, 0.5])
        k = _optimal(a, np.array([[0.0], [1.0], [0.0], [0.0], [0.0]]), weights)
        return np.array([k[0], k[1], *(k[2:] / k[0])])
    travel = np.array([travel_rad_s**2, 1.8 * travel_rad_s, 0.1 * travel_rad_s**3]) / swing
    return np.array([pitch_rad_s**2, 1.8 * pitch_rad_s, *travel])


def _optimal(a: Floats, b: Floats, weights: Floats) -> Floats:
    solution = solve_continuous_are(a, b, weights, np.eye(1))
    return np.asarray((b.T @ solution)[0])


def _places(route: Route, times_s: Floats, rng: np.random.Generator) -> Floats:
    """Reference of elevation and travel, rad, smooth and from level, shape (n, 2)."""
    wanted = np.zeros((len(times_s), 2))
    for i, (most_deg, slow) in enumerate(((route.elevation_deg, 1.0), (route.travel_deg, 2.0))):
        most_rad = np.deg2rad(most_deg)
        if route.sines:
            periods_s = slow * rng.uniform(8.0, 14.0) / np.array([1.0, 1.7])
            phases = rng.uniform(-np.pi, np.pi, 2)
            sizes = most_rad * np.array([0.75, 0.25])
            wave = sizes * np.sin(2.0 * np.pi * times_s[:, None] / periods_s + phases)
            wanted[:, i] += wave.sum(axis=1)
        at_s = np.cumsum(slow * rng.uniform(3.0, 6.0, 60))
        places = most_rad * rng.uniform(-1.0, 1.0, 61) * (0.4 if route.sines else 1.0)
        places[0] = 0.0
        wanted[:, i] += places[np.searchsorted(at_s, times_s)]
    # Two lags each: no step remains, and the motion leads away from the hover.
    step_s = times_s[1] - times_s[0]
    for lag_s in (0.4, np.array([0.4, 0.8])):
        keep = np.exp(-step_s / lag_s)
        out = np.zeros(2)
        for k in range(len(wanted)):
            out = keep * out + (1.0 - keep) * wanted[k]
            wanted[k] = out
    return wanted


def _multisine(times_s: Floats, rng: np.random.Generator) -> Floats:
    """Multisine from 0.1 to 4 Hz with random phases for each motor, peaks of about 1, shape (n, 2)."""
    lines_Hz = np.arange(0.1, 4.0, 0.15)
    phases = rng.uniform(-np.pi, np.pi, (len(lines_Hz), 2))
    turned = 2.0 * np.pi * times_s[:, None, None] * lines_Hz[:, None] + phases
    return np.asarray(np.sin(turned).sum(axis=1) / np.sqrt(1.5 * len(lines_Hz)))

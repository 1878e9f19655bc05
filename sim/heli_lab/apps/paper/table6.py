"""Analyse the stability of pitch and travel with the gains of Table 6, for every interpretation of the table.

The paper prints gains without units, and defines the output U_3 of the travel PID in two ways. By (33), it is
a "virtual control signal" u_3 = sin(phi) U+, so that the pitch setpoint is asin(U_3 / U+). In the cascade of
Fig. 20, it is the pitch setpoint itself, in degrees.

Equation (34) differentiates the error, and hence the pitch setpoint, which already contains the travel rate.
Computed exactly, this is a feedback of acceleration, which no encoder measures. The standard control law, and
the control law of the board, differentiate the measurement instead.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from heli_host.board.parameters import paper_gains
from heli_host.data.arrays import Floats
from heli_sim.model.base import Model
from heli_sim.model.linear import derivatives, trim
from heli_sim.rig import Rig
from scipy.linalg import expm

Reading = Literal["degrees", "u3"]
Derivative = Literal["error", "measurement"]
READINGS: Final[tuple[Reading, ...]] = ("degrees", "u3")
DERIVATIVES: Final[tuple[Derivative, ...]] = ("error", "measurement")
MAX_LAG_s: Final = 0.4
"""Longest thrust lag that is checked [s]: several times that of any rotor of this size."""
_LAGS_s: Final = np.arange(0.001, MAX_LAG_s, 0.001)
_DEG: Final = math.degrees(1.0)
SETTLING_STEP_DEG: Final = 15.0
"""Step of the travel setpoint [deg]."""
_BAND_DEG: Final = 0.5
"""Deviation from the setpoint within which travel has settled [deg]."""
_STEP_s, _STEPS = 0.01, 30_000
"""Length [s] and number of the steps of the simulated step response."""


@dataclass(frozen=True)
class LoopVerdict:
    """Stability and step response of pitch and travel for one interpretation of Table 6."""

    gains: str  # ``printed``, or ``corrected``, with P and I of travel exchanged
    reading: str
    """``degrees`` if the travel PID gives the pitch setpoint in degrees, ``u3`` if it gives sin(phi) U+ in
    volts."""
    derivative: str  # Signal of the derivative: the ``error``, as in (34), or the ``measurement``
    growth_1_per_s: float  # Real part of the dominant pole; negative if it decays
    period_s: float  # Period of the dominant pole; infinite if it is real
    lag_s: float  # Longest stable thrust lag; 0 if no lag is stable
    peak_deg: float
    """Peak of travel after a setpoint step of `SETTLING_STEP_DEG`, without limits; infinite if unstable."""
    settling_time_s: float
    """Time from the step until travel stays within half a degree of the setpoint; infinite if unstable."""


def verdicts(model: Model, rig: Rig) -> list[LoopVerdict]:
    """Analyse pitch and travel of a linearised rig with every interpretation of Table 6, printed gains
    first.
    """
    plant = _TiltPlant.of(model, rig)
    results = []
    for gains, reading, derivative in itertools.product(("printed", "corrected"), READINGS, DERIVATIVES):
        law = _TiltGains.of(gains, plant.pitch_per_unit(reading), derivative)
        closed_loop = plant.closed(law, lag_s=0.0)
        dominant = _dominant_pole(closed_loop)
        is_stable = dominant.real < 0.0
        has_period = abs(dominant.imag) > 1e-9  # a real pole has none
        peak_deg, settling_time_s = _travel_step_metrics(closed_loop) if is_stable else (math.inf, math.inf)
        results.append(
            LoopVerdict(
                gains,
                reading,
                derivative,
                growth_1_per_s=float(dominant.real),
                period_s=2.0 * math.pi / abs(dominant.imag) if has_period else math.inf,
                lag_s=_max_stable_lag_s(plant, law) if is_stable else 0.0,
                peak_deg=peak_deg,
                settling_time_s=settling_time_s,
            )
        )
    return results


def gain_lines(verdicts: dict[str, list[LoopVerdict]]) -> list[str]:
    """Format the stability of each interpretation of Table 6 for a terminal, by name of the model."""
    reading = {"degrees": "pitch in deg", "u3": "u3 in V"}
    lines = ["Table 6 on the linearised rig: are pitch and travel stable, and up to which lag (399 ms: any)?"]
    for model, model_verdicts in verdicts.items():
        lines += ["", f"model {model}"]
        for verdict in model_verdicts:
            if verdict.growth_1_per_s < 0.0:
                step = (
                    f"15 deg step peaks at {verdict.peak_deg:.1f}, settles in {verdict.settling_time_s:.0f} s"
                )
                lag = f"to {1e3 * verdict.lag_s:3.0f} ms of thrust lag"
                text = f"stable,   decays at {-verdict.growth_1_per_s:.3f} 1/s, {lag}; {step}"
            else:
                text = (
                    f"unstable, grows at {verdict.growth_1_per_s:5.3f} 1/s, period {verdict.period_s:.2f} s"
                )
            law = f"{verdict.gains:10} {reading[verdict.reading]:13} derivative of {verdict.derivative:12}"
            lines.append(f"  {law} {text}")
    return lines


@dataclass(frozen=True)
class _TiltGains:
    """Gains of the pitch and the travel loop."""

    pitch: Floats  # pitch, travel: (3,): Gains kp, ki and kd, in V/rad and rad/rad
    travel: Floats
    differentiates_error: bool
    """Whether the pitch loop differentiates its error instead of the measured pitch."""

    @staticmethod
    def of(gains: str, pitch_per_unit: float, derivative: Derivative) -> _TiltGains:
        """Convert the gains of Table 6 from degrees to radians."""
        table = paper_gains(gains)
        pitch = np.array([table[f"pitch_{name}"] for name in ("kp", "ki", "kd")]) * _DEG
        travel = np.array([table[f"travel_{name}"] for name in ("kp", "ki", "kd")]) * pitch_per_unit
        return _TiltGains(pitch, travel, derivative == "error")


@dataclass(frozen=True)
class _TiltPlant:
    """Pitch and travel at hover without thrust lag, linearised: x' = A x + B U-."""

    A: Floats  # A, B: (4, 4): State and input matrix. States: pitch, travel, their rates.
    B: Floats
    sum_V: float  # Sum U+ of the voltages at hover

    @staticmethod
    def of(model: Model, rig: Rig) -> _TiltPlant:
        """Linearise pitch and travel of a rig at hover."""
        hover = trim(model, rig)
        linear = derivatives(model, rig, hover.state, hover.volts_V)
        states = [1, 2, 4, 5]
        return _TiltPlant(
            linear.A[np.ix_(states, states)],
            linear.B[states] @ np.array([0.5, -0.5]),
            float(np.sum(hover.volts_V)),
        )

    def pitch_per_unit(self, reading: Reading) -> float:
        """Return the pitch setpoint [rad] per radian of travel error at a travel gain of 1."""
        # The paper does not state the unit of the travel controller's output U_3, so its gains have two
        # readings: degrees of pitch per degree of travel, or volts per degree.
        # In volts, the paper has sin(phi) U+ = U_3 with the sum of the voltages U+. Near level, one volt is
        # then 1 / U+ rad of pitch, and a radian of travel is 57.3 degrees.
        return 1.0 if reading == "degrees" else _DEG / self.sum_V

    def closed(self, law: _TiltGains, lag_s: float) -> Floats:
        """Return the closed-loop state matrix, (7, 7), or (6, 6) without lag."""
        # Its states are the plant's four, the integrals of travel and of the pitch error, and the lagging U-.
        # Each signal is a row, shape (7,): its derivatives by the states.
        pitch, travel, pitch_rate, travel_rate, travel_integral, error_integral, lagging = np.eye(7)
        kp, ki, kd = law.travel
        pitch_kp, pitch_ki, pitch_kd = law.pitch
        error = -(kp * travel + ki * travel_integral + kd * travel_rate) - pitch
        A = np.zeros((7, 7))
        A[:4, :4], A[:4, 6] = self.A, self.B
        A[4], A[5] = travel, error
        output_V = pitch_kp * error + pitch_ki * error_integral - pitch_kd * pitch_rate
        feedthrough = 0.0
        if law.differentiates_error:
            # The rate of the setpoint contains the travel acceleration, A[3], which depends on thrust.
            output_V = output_V - pitch_kd * (kp * travel_rate + ki * travel + kd * A[3])
            feedthrough = float(output_V[6])
        if lag_s > 0.0:
            A[6] = (output_V - lagging) / lag_s
            return A
        # Without lag, U- equals the control output, which may depend on U- itself: solve for it.
        state_feedback_V = (output_V - feedthrough * lagging)[:6] / (1.0 - feedthrough)
        return A[:6, :6] + np.outer(A[:6, 6], state_feedback_V)


def _dominant_pole(A: Floats) -> complex:
    """Return the eigenvalue of a state matrix with the largest real part [1/s]."""
    poles = np.linalg.eigvals(A)
    return complex(poles[np.argmax(poles.real)])


def _travel_step_metrics(A: Floats) -> tuple[float, float]:
    """Simulate a step of the travel setpoint with the closed-loop state matrix `A`, shape (n, n)."""
    # Returns `peak_deg`, `settling_time_s`.
    # The derivative kick of the setpoint is left out.
    state = np.zeros(len(A))
    # Travel is simulated as the deviation from its setpoint.
    state[1] = -SETTLING_STEP_DEG
    transition, deviation_deg = expm(_STEP_s * A), np.empty(_STEPS)
    for row in range(_STEPS):
        deviation_deg[row] = state[1]
        state = transition @ state
    outside = np.flatnonzero(np.abs(deviation_deg) > _BAND_DEG)
    settling_time_s = math.inf if outside[-1] == _STEPS - 1 else float(outside[-1] + 1) * _STEP_s
    return float(deviation_deg.max()) + SETTLING_STEP_DEG, settling_time_s


def _max_stable_lag_s(plant: _TiltPlant, law: _TiltGains) -> float:
    """Return the longest thrust lag [s] below which the closed loop is stable."""
    longest = 0.0
    for lag_s in _LAGS_s:
        if _dominant_pole(plant.closed(law, float(lag_s))).real >= 0.0:
            break
        longest = float(lag_s)
    return longest

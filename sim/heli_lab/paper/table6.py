"""Table 6 in every reading: whether pitch and travel are stable, and up to which lag of the thrust.

The paper prints gains without units, and two statements of what the travel PID gives out: U_3 is a "virtual
control signal" u_3 = sin(phi) U+ (33), so that the pitch to ask for is asin(U_3 / U+); and the cascade of
Fig. 20 hands it on as pitch's setpoint, which with elevation and pitch in degrees and volts makes it degrees.
(34) takes the derivative of the error, hence also of pitch's setpoint, which holds travel's rate already:
exactly computed, that is an acceleration feedback which no encoder gives. The usual law, and the one on
board, takes the derivative of what is measured.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from heli_host.arrays import Floats
from heli_host.published_gains import paper_gains
from heli_sim.model.base import Model
from heli_sim.model.linear import derivatives, trim
from heli_sim.rig import Rig
from scipy.linalg import expm

Reading = Literal["degrees", "u3"]
Derivative = Literal["error", "measurement"]
READINGS: Final[tuple[Reading, ...]] = ("degrees", "u3")
DERIVATIVES: Final[tuple[Derivative, ...]] = ("error", "measurement")
LONGEST_LAG_s: Final = 0.4
"""Longest thrust lag that is tried: several times what any rotor of this size shows."""
_LAGS_s: Final = np.arange(0.001, LONGEST_LAG_s, 0.001)
_DEG: Final = math.degrees(1.0)
STEP_DEG: Final = 15.0
"""Step of travel's setpoint."""
_BAND_DEG: Final = 0.5
_STEP_s, _STEPS = 0.01, 30_000


@dataclass(frozen=True)
class Verdict:
    """How pitch and travel behave under one reading of Table 6.

    Parameters
    ----------
    gains : str
        ``printed``, or ``corrected``: with P and I of travel exchanged.
    reading : str
        ``degrees``: travel's output is the pitch setpoint in degrees; ``u3``: it is sin(phi) U+ in volts.
    derivative : str
        Of the ``error``, as (34) says, or of the ``measurement``.
    growth_1_per_s : float
        Real part of the dominant pole, 1/s; negative where it decays.
    period_s : float
        Period of the dominant pole; infinite when it is real.
    lag_s : float
        Longest thrust lag that is stable; 0 when none is.
    peak_deg : float
        Peak of travel after a step of its setpoint to `STEP_DEG`, without limits; infinite when unstable.
    settling_time_s : float
        From then until travel stays within half a degree of it; infinite when unstable.
    """

    gains: str
    reading: str
    derivative: str
    growth_1_per_s: float
    period_s: float
    lag_s: float
    peak_deg: float
    settling_time_s: float


def verdicts(model: Model, rig: Rig) -> list[Verdict]:
    """Close pitch and travel with Table 6 around a linearised rig, a `model` without any effect, in every
    reading, printed gains first. A PlantError when the rig cannot hover.
    """
    plant = _Tilt.of(model, rig)
    out = []
    for gains, reading, derivative in itertools.product(("printed", "corrected"), READINGS, DERIVATIVES):
        law = _Law.of(gains, plant.pitch_per_unit(reading), derivative)
        closed = plant.closed(law, 0.0)
        slowest = _slowest(closed)
        peak_deg, settling_time_s = _step(closed) if slowest.real < 0.0 else (math.inf, math.inf)
        out.append(
            Verdict(
                gains,
                reading,
                derivative,
                float(slowest.real),
                2.0 * math.pi / abs(slowest.imag) if abs(slowest.imag) > 1e-9 else math.inf,
                _longest_lag_s(plant, law) if slowest.real < 0.0 else 0.0,
                peak_deg,
                settling_time_s,
            )
        )
    return out


@dataclass(frozen=True)
class _Law:
    """Gains in rad and V: pitch's in V/rad, travel's in rad/rad."""

    pitch: Floats
    travel: Floats
    of_error: bool

    @staticmethod
    def of(gains: str, pitch_per_unit: float, derivative: Derivative) -> _Law:
        table = paper_gains(gains)
        pitch = np.array([table[f"pitch_{name}"] for name in ("kp", "ki", "kd")]) * _DEG
        travel = np.array([table[f"travel_{name}"] for name in ("kp", "ki", "kd")]) * pitch_per_unit
        return _Law(pitch, travel, derivative == "error")


@dataclass(frozen=True)
class _Tilt:
    """Pitch, travel and their rates at hover, driven by U- through thrust without lag: x' = A x + B U-."""

    A: Floats
    B: Floats
    both_V: float

    @staticmethod
    def of(model: Model, rig: Rig) -> _Tilt:
        at = trim(model, rig)
        first = derivatives(model, rig, at.state, at.volts_V)
        pick = [1, 2, 4, 5]
        return _Tilt(
            first.A[np.ix_(pick, pick)], first.B[pick] @ np.array([0.5, -0.5]), float(np.sum(at.volts_V))
        )

    def pitch_per_unit(self, reading: Reading) -> float:
        """Radians of pitch for each radian of travel and unit of gain (output unit per degree)."""
        # sin(phi) U+ = U_3: a volt is asin(1 / U+), near level 1 / U+ radians.
        return 1.0 if reading == "degrees" else _DEG / self.both_V

    def closed(self, law: _Law, lag_s: float) -> Floats:
        """State matrix: the plant, integrals of travel and of pitch's error, thrust behind a lag."""
        kp, ki, kd = law.travel
        unit_rows = np.eye(7)
        # x[:4] the plant, x[4] the integral of travel, x[5] of pitch's error, x[6] U- as thrust follows it.
        setpoint = -(kp * unit_rows[1] + ki * unit_rows[4] + kd * unit_rows[3])
        error = setpoint - unit_rows[0]
        A = np.zeros((7, 7))
        A[:4, :4], A[:4, 6] = self.A, self.B
        A[4], A[5] = unit_rows[1], error
        differential_V = law.pitch[0] * error + law.pitch[1] * unit_rows[5] - law.pitch[2] * unit_rows[2]
        share = 0.0
        if law.of_error:
            # The setpoint's own rate holds travel's acceleration, A[3], thrust included.
            differential_V = differential_V - law.pitch[2] * (
                kp * unit_rows[3] + ki * unit_rows[1] + kd * A[3]
            )
            share = float(differential_V[6])
        if lag_s > 0.0:
            A[6] = (differential_V - unit_rows[6]) / lag_s
            return A
        # Without lag, U- = asked, in which U- itself may appear once more.
        direct = (differential_V - share * unit_rows[6])[:6] / (1.0 - share)
        return A[:6, :6] + np.outer(A[:6, 6], direct)


def _slowest(A: Floats) -> complex:
    poles = np.linalg.eigvals(A)
    return complex(poles[np.argmax(poles.real)])


def _step(A: Floats) -> tuple[float, float]:
    """Highest travel, deg, and settling time after a step, the derivative's kick left out."""
    state = np.zeros(len(A))
    state[1] = -STEP_DEG  # travel, as a deviation from where it is to go
    forward, off_deg = expm(_STEP_s * A), np.empty(_STEPS)
    for row in range(_STEPS):
        off_deg[row] = state[1]
        state = forward @ state
    outside = np.flatnonzero(np.abs(off_deg) > _BAND_DEG)
    settled = math.inf if outside[-1] == _STEPS - 1 else float(outside[-1] + 1) * _STEP_s
    return float(off_deg.max()) + STEP_DEG, settled


def _longest_lag_s(plant: _Tilt, law: _Law) -> float:
    longest = 0.0
    for lag_s in _LAGS_s:
        if _slowest(plant.closed(law, float(lag_s))).real >= 0.0:
            break
        longest = float(lag_s)
    return longest

"""Errors of a calibration."""

from __future__ import annotations

from heli_sim.errors import SimError


class CalibrationError(SimError):
    """A calibration that ended before its result; the motors are off."""

    exit_code = 4

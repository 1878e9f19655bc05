"""Boards whose time goes on with the machine's, flown on a machine that may stall.

A board holds after half a second, and lands after two. A machine that stalls for a second must not end the
flight of a test. A test that flies over a port takes `SilProcess(speed=None)`: time runs ahead of the host by
40 ms only, or as in reality. At five times real time a stall costs five times as much, and samples are lost.
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

PATIENT: Final = {"setpoint_hold_s": 5.0, "setpoint_land_s": 30.0}
"""Longest declared times that a board waits for a setpoint, s; for `Parameters.restore`."""
SOON_LANDING: Final = {"setpoint_hold_s": 5.0, "setpoint_land_s": 10.0}
"""The same where a test waits for the landing."""
SOON_HOLDING: Final = {"setpoint_hold_s": 2.0, "setpoint_land_s": 5.0}
"""The same where it waits for the hold as well, in real time."""


def patient_file(folder: Path) -> Path:
    """Write them as a file for ``--params``."""
    path = folder / "patient.toml"
    path.write_text("[parameters]\n" + "".join(f"{name} = {value}\n" for name, value in PATIENT.items()))
    return path

"""Flies the second controller of a board and prints what it did, as JSON; see test_own_controller.py."""

import contextlib
import json
import math
import tempfile
from pathlib import Path
from typing import Any

import heli_host
import numpy as np
from heli_host.board.heli import Heli
from heli_host.board.parameters import controller_names
from heli_host.board.samples import Samples
from heli_host.data.log.reader import read_log
from heli_host.declaration import Fault, Flags, Result
from heli_host.errors import CommandRefused, HeliError
from heli_host.fly.recorder import Recorder
from heli_lab.control.law import from_gain
from numpy.typing import NDArray
from scipy.signal import lfilter

# As in firmware/examples/lqr.cpp.
PITCH, PITCH_RATE, TRAVEL, TRAVEL_RATE = 1.01, 0.693, 1.73, 4.59
TICKS_PER_S = 1000.0


def rate_rad_s(angle_rad: NDArray[np.float64], cutoff_Hz: float) -> NDArray[np.float64]:
    """The board's rate: the slope behind two first-order low-passes."""
    share = 1.0 - math.exp(-2.0 * math.pi * cutoff_Hz / TICKS_PER_S)
    smooth = angle_rad - angle_rad[0]
    for _ in range(2):
        smooth = lfilter([share], [1.0, share - 1.0], smooth)
    return np.asarray(np.gradient(smooth) * TICKS_PER_S, float)


def differential(heli: Heli, flown: Samples) -> dict[str, float]:
    """How far the flown difference of the voltages is from that of the state feedback."""
    travel_rad_s = rate_rad_s(flown.travel_rad, heli.params["travel_filter_Hz"])
    pitch_rad_s = rate_rad_s(flown.pitch_rad, heli.params["pitch_filter_Hz"])
    setpoint_rad_s = np.convolve(np.gradient(flown.travel_setpoint_rad), np.ones(20) / 20.0, "same")
    expected_V = (
        -PITCH * flown.pitch_rad
        - PITCH_RATE * pitch_rad_s
        + TRAVEL * (flown.travel_setpoint_rad - flown.travel_rad)
        - TRAVEL_RATE * (travel_rad_s - setpoint_rad_s * TICKS_PER_S)
    )
    # The rate filters have forgotten their start after a second.
    flown_V = (flown.front_V - flown.back_V)[1000:]
    return {
        "differential_error_V": float(np.median(np.abs(flown_V - expected_V[1000:]))),
        "differential_range_V": float(np.ptp(flown_V)),
    }


def taken_over(heli: Heli) -> dict[str, Any]:
    """Fly an uploaded law for two seconds; by how much the voltages jump when the controller takes over."""
    gains = np.zeros((2, 6))
    gains[0, [0, 3]] = 8.9, 6.7
    gains[1, [1, 2, 4, 5]] = PITCH, TRAVEL, PITCH_RATE, TRAVEL_RATE
    heli.fly_law(from_gain(gains, hover_V=heli.params["hover_V"], name="uploaded"), duration_s=2.0)
    heli.wait(0.5)
    flown = heli.samples(last_s=1.5)
    by_law = (flown.flags & Flags.LAW) != 0
    (last,) = np.flatnonzero(np.diff(by_law.astype(int)) == -1)
    jump_V = np.abs(np.diff([flown.front_V[last : last + 2], flown.back_V[last : last + 2]]))
    return {"law_flew": bool(by_law.any()), "takeover_jump_V": float(jump_V.max())}


def fault_of_a_dead_travel_encoder(controller: int = 1) -> str:
    """Name of the fault in a hover, shaken in pitch, in which the travel encoder stops counting."""
    shaken = "sil://?speed=max&board=native&encoder_out=travel:10&effect=periodic_torque.pitch=0.05"
    with heli_host.connect(shaken, land_on_exit=True) as heli:
        heli.params.set("controller", controller)
        heli.take_off()
        with contextlib.suppress(HeliError):
            heli.wait(18.0)
        return Fault(int(heli.samples(last_s=15.0).fault.max())).name


def fly(log: Path) -> dict[str, Any]:
    """Fly, and return what was seen."""
    seen: dict[str, Any] = {}
    with heli_host.connect("sil://?speed=max&board=native", land_on_exit=True) as heli:
        seen["names"] = controller_names(heli.session)
        heli.params.set("controller", 1)
        with Recorder(heli, log):
            heli.take_off()
            heli.setpoint(elevation_deg=5.0, travel_deg=20.0)
            heli.wait(3.0)
            try:
                heli.params.set("controller", 0)
            except CommandRefused as error:
                seen["switch"] = Result(error.result).name
            heli.wait(9.0)
        flown = heli.samples(last_s=12.0)
        seen["elevation_deg"] = float(np.degrees(flown.elevation_rad[-1]))
        seen["travel_deg"] = float(np.degrees(flown.travel_rad[-1]))
        seen |= differential(heli, flown) | taken_over(heli)
        heli.land()
        seen["end"] = heli.state.name.lower()
    seen["without_travel"] = fault_of_a_dead_travel_encoder()
    seen["logged"] = read_log(log).metadata["session"]["controller"]
    return seen


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        print(json.dumps(fly(Path(folder) / "flight.mcap")))

"""Flights made by formula, for tests that need samples but no board."""

from pathlib import Path

import numpy as np
from heli_host.data.log.writer import LogWriter
from heli_host.declaration import PARAMS, Axis, Channel, Flags, State
from heli_host.link.channels import rad_per_count
from numpy.typing import NDArray

from tests.channels.groups import COUNTS, SETPOINTS

PARAMETERS = {spec.name: spec.default for spec in PARAMS}
RAD_PER_COUNT = rad_per_count(PARAMETERS)
WALL_NS = 1_700_000_000_000_000_000
BATCH = 20


def make_samples(
    n: int, first_tick: int = 5000, seed: int = 1
) -> tuple[NDArray[np.uint32], NDArray[np.int32]]:
    """Return ticks (n,) and raw numbers (n, channels): rest, arming, rise, a sine on two axes, landing."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(n) * 1e-3
    end_s = n * 1e-3
    edges_s = np.array([0.03, 0.05, 0.85, 0.97]) * end_s
    flying = (t_s >= edges_s[1]) & (t_s < edges_s[2])
    rise = np.clip((t_s - edges_s[1]) / (0.1 * end_s), 0.0, 1.0)
    sink = np.clip((t_s - edges_s[2]) / (0.1 * end_s), 0.0, 1.0)
    wave = np.sin(2.0 * np.pi * np.clip(t_s - 0.2 * end_s, 0.0, 0.6 * end_s) / (0.2 * end_s))
    setpoint_deg = np.column_stack(
        (
            -25.0 * (1.0 - rise) - 25.0 * sink + 5.0 * wave * flying,
            6.0 * np.roll(wave, 250) * flying,
            20.0 * wave * flying,
        )
    )
    lags = zip(Axis, (60, 40, 300), strict=True)
    angle_deg = np.column_stack([np.roll(setpoint_deg[:, axis], lag) for axis, lag in lags])
    raw = np.zeros((n, len(Channel)), np.int32)
    raw[:, COUNTS] = np.rint(np.deg2rad(angle_deg) / RAD_PER_COUNT) + rng.integers(-1, 2, angle_deg.shape)
    raw[:, SETPOINTS] = np.rint(np.deg2rad(setpoint_deg) * 1e5)
    collective_mV = 1700.0 * flying + 1400.0 * (t_s >= edges_s[2]) * (t_s < edges_s[3])
    for motor, sign in ((Channel.FRONT, 8.0), (Channel.BACK, -8.0)):
        noise_mV = 40.0 * rng.standard_normal(n) * flying
        raw[:, motor] = np.rint(collective_mV + sign * setpoint_deg[:, Axis.PITCH] + noise_mV)
    states = (State.IDLE, State.ARMED, State.CLOSED_LOOP, State.LANDING, State.IDLE)
    raw[:, Channel.STATE] = np.array(states)[np.searchsorted(edges_s, t_s, side="right")]
    raw[:, Channel.FLAGS] = Flags.LINK_ALIVE
    return (np.uint32(first_tick) + np.arange(n, dtype=np.uint32)).astype(np.uint32), raw


def open_writer(path: Path) -> LogWriter:
    """Return a writer with the metadata of a flight."""
    return LogWriter(
        path,
        start_wall_ns=WALL_NS,
        metadata={
            "session": {
                "rig": "makki2024",
                "board": "native",
                "firmware": "0.1.0",
                "axes": "elevation pitch travel",
            },
            "parameters": {name: repr(value) for name, value in PARAMETERS.items()},
            "plan": {"sine": 'title = "made"\n'},
        },
        rad_per_count=RAD_PER_COUNT,
    )


def write_made_log(
    path: Path, n: int = 5000, batch: int = BATCH
) -> tuple[NDArray[np.uint32], NDArray[np.int32]]:
    """Write a whole made flight as a log, and return what went into it."""
    tick, raw = make_samples(n)
    writer = open_writer(path)
    for start in range(0, n, batch):
        writer.write_ticks(tick[start : start + batch], raw[start : start + batch])
        for at, name, text in (
            (0.05, "phase", "take-off"),
            (0.2, "phase", "sine"),
            (0.85, "phase", "landing"),
        ):
            if start <= at * n < start + batch:
                writer.write_event(int(tick[int(at * n)]), name, text)
    writer.write_link(int(tick[-1]), {"frames_ok": n // 20, "frames_bad": 0, "retries": 0, "reconnects": 0})
    writer.close({"result": {"outcome": "completed"}})
    return tick, raw

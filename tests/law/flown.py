"""Flights of laws on simulated boards, and the same flights replayed on the host."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import heli_host
import numpy as np
import numpy.typing as npt
from heli_host.board.law_flight import PART_WORDS, LawReport, engage
from heli_host.board.law_program import LawProgram
from heli_host.declaration import AXES, PARAMS, Channel, Flags, LawBeginMessage, LawEndMessage, LawPartMessage
from heli_host.link.telemetry import Ticks
from heli_lab.law import Law
from heli_test_native import law as native_law

from tests.firmware.cost import PERIOD_S, Flight

LAWS = Path(__file__).resolve().parents[2] / "docs" / "laws"
"""Laws of the documents."""
DUTY_FULL = {"native": 2100, "due": 2100}
COUNTS = [Channel.ELEVATION_COUNT, Channel.PITCH_COUNT, Channel.TRAVEL_COUNT]
SETPOINTS = [Channel.ELEVATION_SETPOINT, Channel.PITCH_SETPOINT, Channel.TRAVEL_SETPOINT]
MOTORS = [Channel.FRONT, Channel.BACK]
SIGNALS = [Channel.SIGNAL_1, Channel.SIGNAL_2, Channel.SIGNAL_3, Channel.SIGNAL_4]


def law_of(path: Path) -> Law:
    """The ``LAW`` of a file."""
    import runpy

    law = runpy.run_path(str(path))["LAW"]
    assert isinstance(law, Law)
    return law


def upload_messages(program: LawProgram, request: int = 0) -> list[Any]:
    """Messages of an upload, in order, the first with this request number."""
    words = program.words
    messages: list[Any] = [LawBeginMessage(request, program.hash, len(words))]
    for first in range(0, len(words), PART_WORDS):
        part = [*words[first : first + PART_WORDS], *([0] * PART_WORDS)][:PART_WORDS]
        messages.append(LawPartMessage(request + len(messages), first, *part))
    return [*messages, LawEndMessage(request + len(messages))]


@dataclass(frozen=True)
class Flown:
    """A flight of a law: every tick since the session began."""

    # ``raw`` (n, channels) as logged; ``flying`` (n,) where the law's voltages acted.

    report: LawReport
    raw: npt.NDArray[np.int32]
    params: tuple[float, ...]

    @property
    def flying(self) -> npt.NDArray[np.bool_]:
        return np.asarray(self.raw[:, Channel.FLAGS] & Flags.LAW, bool)


def fly(
    program: LawProgram, board: str = "native", seconds: float = 20.0, options: str = "", **change: Any
) -> Flown:
    """Take off, fly the law through steps and sines of both setpoints, land."""
    # ``change`` holds parameters of the law to set half-way.
    ticks: list[Ticks] = []
    with heli_host.connect(f"sil://?board={board}{options}") as heli:
        heli.session.subscribe_ticks(ticks.append)
        params = tuple(heli.params[spec.name] for spec in PARAMS)
        heli.take_off()
        start = heli.latest.tick

        def steer(new: Ticks) -> None:
            t_s = (int(new.tick[-1]) - start) * 1e-3
            heli.setpoint(
                elevation_deg=4.0 * np.sin(2.0 * np.pi * t_s / 15.0),
                travel_deg=15.0 * np.sin(2.0 * np.pi * t_s / 20.0) if t_s > 6.0 else 6.0,
            )

        unsubscribe = heli.session.subscribe_ticks(steer)
        report = heli.fly_law(program, duration_s=seconds / 2 if change else seconds, after="hold")
        if change and not report.taken_over:
            report = heli.fly_law(program, duration_s=seconds / 2, after="hold", parameters=change)
        unsubscribe()
        heli.wait(0.5)
        heli.land()
    raw = np.concatenate([part.raw for part in ticks])
    tick = np.concatenate([part.tick for part in ticks]).astype(np.int64)
    assert (np.diff(tick) == 1).all(), "a tick was lost"
    return Flown(report, raw, params)


def fly_and_steer(flight: Flight, program: LawProgram, seconds: float) -> None:
    """Fly a law on a board whose instructions are counted, with setpoints that move."""
    heli = flight.heli
    heli.take_off(0.0)
    engage(heli, program)
    for k in range(round(seconds / PERIOD_S)):
        t_s = k * PERIOD_S
        heli.setpoint(elevation_deg=5.0 * float(np.sin(2.0 * t_s)), travel_deg=8.0 * float(np.sin(1.3 * t_s)))
        heli.wait(PERIOD_S)
    heli.stop()


def replayed(flown: Flown, program: LawProgram, board: str = "native") -> int:
    """Replay every tick in which the law's voltages acted, and return their number; a difference fails."""
    # A law may log a setpoint of its own instead of the board's, which is then in a signal.
    axis_of_signal = {f"board_{axis}_setpoint_rad": number for number, axis in enumerate(AXES)}
    setpoint_channels = {
        axis_of_signal[name]: channel
        for name, channel in zip(program.signal_names, SIGNALS, strict=False)
        if name in axis_of_signal
    }
    replay = native_law.LawReplay(flown.params, DUTY_FULL[board])
    assert replay.load(program.words, program.hash) == 0
    flying, count = flown.flying, 0
    for tick, row in enumerate(flown.raw.tolist()):
        replay.measure([row[channel] for channel in COUNTS])
        if not flying[tick]:
            continue
        if not flying[tick - 1]:
            # The law takes over from the voltages of the tick before.
            previous = flown.raw[tick - 1]
            assert replay.engage(int(previous[Channel.FRONT]), int(previous[Channel.BACK])), "not loaded"
        setpoints = [row[channel] for channel in SETPOINTS]
        # The board gives the law a setpoint of pitch of 0; the logged one is the law's.
        setpoints[AXES.index("pitch")] = 0
        for axis, channel in setpoint_channels.items():
            setpoints[axis] = row[channel]
        replayed_volts = replay.update(setpoints)
        assert replayed_volts is not None, f"the replay was taken over at tick {tick}"
        flown_volts = (row[Channel.FRONT], row[Channel.BACK])
        assert replayed_volts == flown_volts, (
            f"tick {tick}, {count} after the first: replayed {replayed_volts}, flown {flown_volts}"
        )
        setpoints_out, signals_out = replay.outputs()
        assert list(setpoints_out) == [row[channel] for channel in SETPOINTS], tick
        assert list(signals_out) == [row[channel] for channel in SIGNALS], tick
        count += 1
    return count

"""The scripts whose outcome is recorded, by name. Each reaches another part of the flight code."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

from heli_host import declaration as d

from tests.flight import script_commands as commands
from tests.flight import script_parts as parts
from tests.flight.scripts import Board, Laws, hover, land, take_off, wander

_ROUGH: Final = {"gust_rad_s2": 0.3, "friction_rad_s2": 0.02}


@dataclass(frozen=True)
class Script:
    """What is done to a board, and the arm that its motors move."""

    play: Callable[[Any, Laws], None]
    arm: dict[str, float] = field(default_factory=dict)


def flight(board: Board, _laws: Laws) -> None:
    """Rise, wander, land."""
    take_off(board)
    wander(board, 8.0)
    land(board)


def other_parameters(board: Board, _laws: Laws) -> None:
    """A flight with every parameter a little off, then one with parameters that change in flight."""
    for spec in d.PARAMS:
        if spec.name.endswith(("counts_per_rev", "sign", "controller", "rest_deg", "supply_V")):
            continue
        near = spec.default * (1.0 + 0.2 * (2.0 * board.chance.random() - 1.0))
        board.set(**{spec.name: min(max(round(near) if spec.integer else near, spec.min), spec.max)})
    take_off(board, seconds=2.0)
    for _ in range(12):
        spec = board.chance.choice([spec for spec in d.PARAMS if not spec.idle_only])
        board.set(**{spec.name: spec.default * (0.8 + 0.4 * board.chance.random())})
        wander(board, 1.0)
    land(board)
    board.ask(d.ParamsSaveMessage)
    board.ask(d.ParamsOriginReadMessage)


def encoder_dies(board: Board, _laws: Laws, axis: int) -> None:
    """An encoder stops counting in flight; the board lands."""
    take_off(board)
    wander(board, 3.0)
    board.freeze(axis)
    wander(board, 6.0, (5.0, 0.0, 20.0) if axis else (12.0, 0.0, 20.0))
    board.run(3000)
    board.ask(d.ClearFaultMessage)
    board.ask(d.StatusReadMessage)


def encoders_die(board: Board, _laws: Laws, axis: int) -> None:
    """An encoder dies again and again, at any moment, also under a hard drive and on the ground."""
    chance = board.chance
    for _ in range(9):
        board.set(travel_motion_deg=4.0 + 8.0 * chance.random(), motion_s=0.3 + chance.random())
        board.set(following_s=0.3 + chance.random(), travel_motion_s=0.5 + chance.random())
        board.arm.gain = chance.choice((0.5, 1.0, 1.5))
        take_off(board, 10.0 * (chance.random() - 0.5), 1.5 + 2.0 * chance.random())
        wander(board, chance.choice((0, 1, 2)), (10.0, 0.0, 40.0))
        board.freeze(axis)
        span_deg = chance.choice(((14.0, 0.0, 100.0), (2.0, 0.0, 10.0)))
        for _ in range(6):
            wander(board, 1.0, span_deg)
            if board.core.state in (d.State.FAULT, d.State.EMERGENCY_LANDING):
                break
        board.run(chance.choice((10, 1500)))
        board.put_back()


def probes(board: Board, _laws: Laws) -> None:
    """Travel that friction holds, with an encoder that lives or not, is asked at several elevations."""
    chance = board.chance
    for k in range(6):
        board.arm.friction_rad_s2 = chance.choice((0.01, 0.02, 0.03))
        board.set(travel_silence_s=chance.choice((2.5, 1.0)), travel_motion_deg=chance.choice((8.0, 6.0)))
        take_off(board, (0.0, -10.0, 8.0)[k % 3], 3.0)
        if k % 2:
            board.freeze(2)
        hover(board, 9.0, ((0.0, -10.0, 8.0)[k % 3], 0.0, 0.0))
        board.put_back()


def host_stops(board: Board, _laws: Laws) -> None:
    """Setpoints stop; the board holds, then lands. A second flight is stopped in each state."""
    take_off(board)
    board.run(800)
    hover(board, 0.5, (3.0, 0.0, 5.0))
    board.run(9000)
    for ticks in (5, 700, 2600):
        board.ask(d.ArmMessage)
        board.ask(d.ControlMessage, 3, 1.0, 1.0)
        hover(board, 1.0, (-5.0, 4.0, 0.0))
        board.run(ticks)
        board.ask(d.StopMessage)
        board.run(1500)
    board.ask(d.ArmMessage)
    board.run(3000)
    board.ask(d.ArmMessage)
    board.ask(d.ControlMessage, 0, 1.5, 1.6)
    board.run(6000)


def streams(board: Board, _laws: Laws) -> None:
    """The host streams voltages near hover, late, beyond their range, and with setpoints of its own."""
    take_off(board, seconds=2.0)
    board.ask(d.StreamMessage)
    for k in range(150):
        board.send(
            d.VoltagesMessage(1.7 + 0.2 * board.chance.random(), 1.65, board.chance.choice((5, 30, 500)))
        )
        if k % 3 == 0:
            board.send(d.FollowingMessage(0.1, 0.01 * k, -0.2))
        if k % 40 == 39:
            board.send(d.VoltagesMessage(11.0, 1.0, 20))
            board.point(1.0, 1.0, 1.0)
        board.run(board.chance.choice((3, 10, 20)))
    board.ask(d.ExciteMessage, 2, 0.3, -0.3, 0.0, 0.0, 0.4, 0)
    board.run(700)
    hover(board, 2.0, (0.0, 0.0, 0.0))
    board.run(6000)


def law(board: Board, laws: Laws, name: str = "steady") -> None:
    """A law that came over the link flies, is changed in flight, and hands over."""
    board.upload(*laws[name])
    board.ask(d.LawFlyMessage, 1)
    take_off(board)
    for on in (1, 1):
        board.ask(d.LawFlyMessage, on)
    wander(board, 3.0, (4.0, 2.0, 15.0))
    board.ask(d.LawSetMessage, 0, 1.2)
    board.ask(d.LawSetMessage, 9, 1.2)
    board.ask(d.LawBeginMessage, 1, 20)
    board.ask(d.ExciteMessage, 2, 0.2, -0.2, 0.0, 0.0, 0.3, 0)
    wander(board, 4.0, (4.0, 2.0, 15.0))
    board.ask(d.LawReadMessage)
    board.ask(d.LawFlyMessage, 0)
    wander(board, 4.0, (4.0, 2.0, 15.0))
    board.ask(d.LawFlyMessage, 1)
    hover(board, 0.4, (1.0, 0.0, 0.0))
    land(board, 5000)


def thrown(board: Board, laws: Laws) -> None:
    """Laws fly until the board takes over, from many attitudes; then it brings the arm back."""
    chance = board.chance
    for k in range(8):
        board.upload(*laws[("throws", "steady", "own setpoints", "divides by zero")[k % 4]])
        board.set(law_envelope=chance.choice((0.5, 0.8, 1.0)), law_jump_max_V=chance.choice((2.5, 6.0)))
        take_off(board, 16.0 * (chance.random() - 0.5), 2.5)
        hover(board, 0.5, (0.0, 0.0, chance.choice((0.0, 60.0, -120.0))))
        board.ask(d.LawFlyMessage, 1)
        board.ask(d.LawSetMessage, 0, chance.choice((1.0, 0.6, 1.3, 2.0, -1.0)))
        hover(board, 3.0, (2.0, 0.0, board.arm.angle[2] * 50.0))
        board.ask(d.LawFlyMessage, 0)
        wander(board, 5.0, (8.0, 0.0, 30.0))
        board.put_back()


def law_rests(board: Board, laws: Laws) -> None:
    """A law flies while friction holds travel; then the board's own controller does."""
    board.upload(*laws["steady"])
    take_off(board)
    board.ask(d.LawFlyMessage, 1)
    hover(board, 10.0, (0.0, 0.0, 0.0))
    board.ask(d.LawFlyMessage, 0)
    hover(board, 6.0, (0.0, 0.0, 0.0))
    board.ask(d.ControlMessage, 3, 0.0, 0.0)
    hover(board, 4.0, (0.0, 2.0, 0.0))


def law_sinks(board: Board, laws: Laws) -> None:
    """A law follows a setpoint down to the table, three times."""
    board.upload(*laws["steady"])
    take_off(board, 12.0, 3.5)
    # Slow braking: the guard foresees the table from far above.
    board.set(elevation_acceleration_deg_s2=6.0)
    for low_deg in (-25.5, -20.0, -25.5):
        board.ask(d.LawFlyMessage, 1)
        hover(board, 3.0, (low_deg, 0.0, 0.0))
        hover(board, 4.0, (18.0, 0.0, 0.0))


def bad_tapes(board: Board, laws: Laws) -> None:
    """A law is uploaded with one bit wrong, with words missing, and twice."""
    words, crc = laws["steady"]
    for _ in range(150):
        changed = list(words)
        changed[board.chance.randrange(len(changed))] ^= 1 << board.chance.randrange(32)
        data = struct.pack(f"<{len(changed)}I", *changed)
        board.upload(changed, zlib.crc32(data) if board.chance.random() < 0.9 else crc)
    board.upload(words[:-1], crc)
    board.ask(d.LawBeginMessage, crc, 0)
    board.ask(d.LawBeginMessage, crc, 2000)
    board.ask(d.LawPartMessage, 0, *([0] * 12))
    board.upload(words, crc)
    board.ask(d.LawEndMessage)


SCRIPTS: Final[dict[str, Script]] = {
    "fixed point": Script(parts.fixed_point),
    "operations": Script(parts.operations),
    "parameters in flash": Script(parts.parameters_in_flash),
    "line under load": Script(parts.line_under_load),
    "tapes": Script(parts.tapes),
    "parameters that do not fit": Script(commands.inconsistent),
    "noise on the line": Script(commands.noise_on_the_line),
    "parameters at edges": Script(commands.parameters_at_edges),
    "bad tapes": Script(bad_tapes),
    "excitations": Script(commands.excitations),
    "any commands 1": Script(commands.any_commands, {"gust_rad_s2": 0.2}),
    "any commands 2": Script(commands.any_commands, {"gust_rad_s2": 0.2}),
    "moved by hand": Script(commands.moved_by_hand),
    "streams": Script(streams),
    "host stops": Script(host_stops),
    "flight": Script(flight),
    "flight in gusts": Script(flight, {"gust_rad_s2": 0.8}),
    "weak motors": Script(flight, {"gain": 0.35}),
    "strong motors": Script(flight, {"gain": 2.5, "friction_rad_s2": 0.02}),
    "other parameters 1": Script(other_parameters, {"gust_rad_s2": 0.3}),
    "other parameters 2": Script(other_parameters, {"gust_rad_s2": 0.3}),
    "elevation encoder dies": Script(partial(encoder_dies, axis=0)),
    "pitch encoder dies": Script(partial(encoder_dies, axis=1), {"gust_rad_s2": 0.2}),
    "travel encoder dies": Script(partial(encoder_dies, axis=2), {"gust_rad_s2": 0.2}),
    "law": Script(law),
    "law that throws": Script(partial(law, name="throws"), {"gust_rad_s2": 0.2}),
    "law that jumps": Script(partial(law, name="jumps")),
    "law without numbers": Script(partial(law, name="divides by zero")),
    "law with wishes": Script(partial(law, name="own setpoints")),
    "law at rest": Script(law_rests, {"stir_rad_s2": 0.9, "friction_rad_s2": 0.03}),
    "law that sinks": Script(law_sinks, {"gain": 0.8}),
    "elevation encoder dies often": Script(partial(encoders_die, axis=0), _ROUGH),
    "pitch encoder dies often": Script(partial(encoders_die, axis=1), _ROUGH),
    "travel encoder dies often": Script(partial(encoders_die, axis=2), _ROUGH),
    "probes 1": Script(probes, {"stir_rad_s2": 0.9}),
    "probes 2": Script(probes, {"stir_rad_s2": 0.9}),
    "laws that throw often 1": Script(thrown, {"gust_rad_s2": 0.1}),
    "laws that throw often 2": Script(thrown, {"gust_rad_s2": 0.1}),
}
"""The seed of a script is its place in this table."""
PARTS: Final = tuple(list(SCRIPTS)[:5])
"""Those that need no whole board."""

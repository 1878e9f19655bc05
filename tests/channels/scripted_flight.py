"""A flight whose every byte towards the board leaves at a fixed tick, whatever comes back.

So it is the same flight under any declaration of telemetry, tick by tick. Run as a program it writes what the
board sent: ``ticks.npz`` (tick and raw numbers by channel), ``flight.mcap``, and the log as ``flight.csv``,
``flight.mat`` and ``flight.parquet``.
"""

import sys
from pathlib import Path
from typing import Any

import numpy as np
from heli_host import declaration as d
from heli_host.board.flying import ALL_AXES
from heli_host.data.log.reader import read_flight
from heli_host.data.log.table import export_mat, export_parquet, write_csv
from heli_host.data.log.writer import LogWriter
from heli_host.link.channels import numbers, rad_per_count
from heli_host.link.frames import FrameParser, encode_frame
from heli_host.link.telemetry import TelemetryDecoder, Ticks
from heli_sim.sil.options import SilOptions
from heli_sim.sil.world import SilWorld

STEP_TICKS = 100
STEPS = 200
"""20 s, in messages every 0.1 s."""

SCRIPT: dict[int, Any] = {
    0: d.HelloMessage(request=1, link_hash=d.LINK_HASH, session=7),
    5: d.ArmMessage(2),
    6: d.ControlMessage(request=3, axes=int(ALL_AXES), front_V=0.0, back_V=0.0),
    90: d.ExciteMessage(
        request=4,
        kind=int(d.Excitation.PRBS),
        front_V=0.3,
        back_V=0.2,
        start_Hz=0.0,
        stop_Hz=8.0,
        duration_s=3.0,
        seed=5,
    ),
    140: d.LandMessage(5),
    188: d.ArmMessage(6),
}
TILT_STEP, TILT_DEG = 192, 60.0
"""When the arm, armed again on the table, is tilted so far that the board trips a fault."""


def message_of(step: int) -> Any:
    """Messages of a step: an entry of the script; in flight setpoints, and pings that show the host is
    alive."""
    if step in SCRIPT:
        return SCRIPT[step]
    if 10 <= step < 140 and step % 2:
        elevation_deg, travel_deg = min(-25.0 + 0.6 * (step - 10), 3.0), 15.0 if step > 60 else 0.0
        target_rad = np.radians((elevation_deg, 0.0, travel_deg)).tolist()
        return d.SetpointMessage((step + 2) * STEP_TICKS, *target_rad)
    return d.PingMessage(100 + step % 50, step)


def fly() -> Ticks:
    """Fly the script on the simulated board; every tick that it sent."""
    world, parser, decoder = SilWorld(SilOptions()), FrameParser(), TelemetryDecoder()
    payloads: list[bytes] = []
    for step in range(STEPS):
        if step == TILT_STEP:
            tilted = world.state
            tilted[d.Axis.PITCH] = np.radians(TILT_DEG)
            world.state = tilted
        message = message_of(step)
        data = world.advance(STEP_TICKS, encode_frame(message.ID, step % 256, message.pack()))
        payloads += [frame.payload for frame in parser.feed(data) if frame.id == d.MessageId.TELEMETRY]
    assert parser.frames_bad == 0
    return decoder.decode(payloads)


def write(ticks: Ticks, folder: Path) -> None:
    """Write what was received, as numbers, as a log, and the log for other programs."""
    columns: dict[str, Any] = {str(channel): numbers(ticks.raw, channel) for channel in d.Channel}
    np.savez(folder / "ticks.npz", **{"board tick": ticks.tick, **columns})
    parameters = {spec.name: spec.default for spec in d.PARAMS}
    writer = LogWriter(
        folder / "flight.mcap",
        start_wall_ns=0,
        metadata={"parameters": {name: repr(value) for name, value in parameters.items()}},
        rad_per_count=rad_per_count(parameters),
    )
    writer.write_ticks(ticks.tick, ticks.raw)
    writer.close()
    flight = read_flight(folder / "flight.mcap")
    write_csv(flight, folder / "flight.csv")
    export_mat(flight, folder / "flight.mat")
    export_parquet(flight, folder / "flight.parquet")


if __name__ == "__main__":
    write(fly(), Path(sys.argv[1]))

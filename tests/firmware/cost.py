"""Cost of the firmware in instructions, counted on the emulated board over its most expensive flights.

Command line: ``python -m tests.firmware.cost ELF`` prints a table. Counts are exact and repeatable: an
interrupt's are its own, without those of a more urgent one that came in between.
"""

import argparse
import math
import subprocess
import tempfile
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Final

from due_emulator import ExceptionStats, ProbeStats, new_due
from due_emulator import read_image as read_program
from heli_host.board.heli import Heli
from heli_host.declaration import Axes, Param, ParamSetMessage, State

from firmware.due.report import Image, read_image
from tests.firmware.desk import TICK_INTERRUPT, TRAVEL_INTERRUPT, Arm, Board

ROOT: Final = Path(__file__).resolve().parents[2]
PROGRAMS: Final = ROOT / "sim" / "due" / "tests" / "programs"
FLAGS: Final = ROOT / "firmware" / "due" / "compile.flags"
CASCADE: Final = "_ZN4heli7control7Cascade4step"
LAW_UPDATE: Final = "_ZN4heli3law11UploadedLaw6updateE"
PID_LOOPS: Final = "three_loops"
EXCITATIONS: Final = ("step", "doublet", "chirp", "multisine", "prbs")
HOVERING: Final = Axes.ELEVATION | Axes.PITCH
PERIOD_S: Final = 0.02


@dataclass(frozen=True)
class Costs:
    """Instructions of the parts that must be quick."""

    tick_instructions_max: int  # The whole control tick, from its vector to its return
    tick_instructions_mean: float  # The whole control tick, from its vector to its return
    cascade_instructions_max: int  # The control law alone, as a part of the tick
    encoder_isr_instructions_max: int  # The interrupt at each edge of the travel encoder
    # Three loops of Arduino's PID_v1, for scale: arithmetic only, no filter, no mixer, no feed-forward
    pid_v1_three_loops_instructions: int


class Flight:
    """A flight that counts."""

    def __init__(self, elf: Path, image: Image, probes: tuple[str, ...] = (CASCADE,)) -> None:
        self.board = Board(elf, image, Arm())
        self.addresses = {
            probe: value & ~1
            for probe in probes
            for name, value in image.symbols.items()
            if name.startswith(probe)
        }
        for address in self.addresses.values():
            self.board.due.add_probe(address)
        self.heli: Heli = self.board.connect()

    def tick_cost(self) -> ExceptionStats:
        """Count the ticks so far and their instructions."""
        return self.board.due.exception_stats(TICK_INTERRUPT)

    def function_cost(self, probe: str) -> ProbeStats:
        """Count the calls of a probed function so far and their instructions."""
        return self.board.due.probe(self.addresses[probe])

    def sweep(self, seconds: float, max_deg: float = 5.0) -> None:
        """Stream setpoints that keep all three axes moving and both shapers braking."""
        for k in range(round(seconds / PERIOD_S)):
            t = k * PERIOD_S
            sign = 1.0 if math.sin(4.0 * t) > 0.0 else -1.0
            self.heli.setpoint(
                elevation_deg=max_deg * (0.4 * sign + 0.6 * math.sin(2.0 * t)),
                pitch_deg=8.0 * math.sin(5.0 * t),
                travel_deg=2.0 * max_deg * (0.4 * sign + 0.6 * math.sin(1.3 * t)),
            )
            # Parameters change in the tick too.
            if k % 10 == 0:
                self.heli.session.command(ParamSetMessage(0, Param.ELEVATION_SLEW_DEG_S, 15.0 + 0.1 * k))
            self.heli.wait(PERIOD_S)


def _excited(flight: Flight) -> None:
    heli = flight.heli
    heli.take_off(0.0)
    for kind in EXCITATIONS:
        heli.excite(kind, front_V=0.2, back_V=-0.15, start_Hz=0.3, stop_Hz=5.0, duration_s=0.8)
        flight.sweep(1.0)
    heli.excite("multisine", front_V=0.2, back_V=0.2, start_Hz=0.3, stop_Hz=5.0, duration_s=10.0)
    flight.sweep(0.4)
    heli.control(HOVERING)
    flight.sweep(0.6, max_deg=3.0)
    heli.control()
    flight.sweep(0.6, max_deg=3.0)
    heli.land()


def _abandoned(flight: Flight) -> None:
    heli = flight.heli
    heli.take_off(2.0)
    flight.sweep(1.0)
    heli.excite("multisine", front_V=0.2, back_V=0.2, start_Hz=0.3, stop_Hz=5.0, duration_s=10.0)
    heli.keep_alive = False
    heli.session.wait_for(lambda: heli.session.state is State.HOLD, 3.0)
    heli.session.wait_for(lambda: heli.session.state is State.LANDING, 5.0)
    heli.session.wait_for(lambda: heli.session.state is State.IDLE, 20.0)


def _streamed(flight: Flight) -> None:
    heli = flight.heli
    heli.arm()
    heli.stream()
    heli.excite("multisine", front_V=0.3, back_V=0.3, start_Hz=0.3, stop_Hz=5.0, duration_s=2.0)
    for _ in range(50):
        heli.voltages(front_V=1.5, back_V=1.4)
        heli.wait(0.01)
    heli.land()
    heli.wait(2.0)
    heli.arm()
    heli.control(Axes(0), front_V=1.6, back_V=1.5)
    heli.excite("prbs", front_V=0.3, back_V=0.3, stop_Hz=20.0, duration_s=1.0)
    heli.wait(0.5)
    heli.stop()


def _tripped(flight: Flight) -> None:
    heli = flight.heli
    heli.take_off(2.0)
    heli.excite("multisine", front_V=0.2, back_V=0.2, start_Hz=0.3, stop_Hz=5.0, duration_s=10.0)
    flight.sweep(0.5)
    # 17 degrees in a millisecond: rates beyond their limits.
    for axis in range(3):
        for k in range(190):
            flight.board.due.schedule_step(
                axis, direction=1, when_us=flight.board.due.now_us + 10.0 + 5.0 * k
            )
    heli.session.wait_for(lambda: heli.session.state is State.FAULT, 25.0)
    heli.clear_fault()


def _stopped(flight: Flight) -> None:
    heli = flight.heli
    heli.take_off(0.0)
    heli.excite("multisine", front_V=0.2, back_V=0.2, start_Hz=0.3, stop_Hz=5.0, duration_s=10.0)
    flight.sweep(0.5)
    flight.board.press_stop()
    heli.session.wait_for(lambda: heli.session.state is State.FAULT, 1.0)


def _crowded(flight: Flight) -> None:
    heli = flight.heli
    heli.take_off(0.0)
    heli.excite("multisine", front_V=0.2, back_V=0.2, start_Hz=0.3, stop_Hz=5.0, duration_s=30.0)
    for k in range(40):
        # The USB bridge delivers everything that it kept together: as many setpoints as the board queues,
        # and a command.
        for axis_deg in range(4):
            heli.setpoint(elevation_deg=0.1 * k, pitch_deg=2.0 * axis_deg, travel_deg=0.2 * k)
        heli.excite("multisine", front_V=0.2, back_V=0.2, start_Hz=0.3, stop_Hz=5.0, duration_s=30.0)
        heli.wait(0.0013 * (k % 8))
    heli.stop()


FLIGHTS: Final[tuple[Callable[[Flight], None], ...]] = (
    _excited, _abandoned, _streamed, _tripped, _stopped, _crowded
)  # fmt: skip


def fly_the_worst(elf: Path, probes: tuple[str, ...] = (CASCADE,)) -> list[Flight]:
    """Fly what asks most of a tick: setpoints moving, excitation running, and every way to end."""
    image = read_image(elf)
    flights = []
    for fly in FLIGHTS:
        flight = Flight(elf, image, probes)
        fly(flight)
        flights.append(flight)
    return flights


def link_program(elf: Path, *object_files: Path, cross: str = "arm-none-eabi-") -> None:
    """Link a program that runs on an emulated Due without the firmware."""
    command = [f"{cross}gcc", "-mcpu=cortex-m3", "-mthumb", "-nostartfiles", f"-T{PROGRAMS / 'due.ld'}"]
    files = (PROGRAMS / "start.S", *object_files)
    subprocess.run([*command, *files, "-lgcc", "-o", elf], check=True)


def measure_pid_v1(cross: str = "arm-none-eabi-") -> int:
    """Count three loops of Arduino's PID_v1, compiled with the firmware's flags."""
    with tempfile.TemporaryDirectory() as folder:
        elf = Path(folder) / "pid_v1.elf"
        object_file = Path(folder) / "pid_v1.o"
        source = Path(__file__).with_name("pid_v1.cpp")
        subprocess.run([f"{cross}g++", f"@{FLAGS}", "-c", source, "-o", object_file], check=True)
        link_program(elf, object_file, cross=cross)
        program = read_program(elf)
        due = new_due(program)
        address = program.address(PID_LOOPS)
        due.add_probe(address)
        due.power_on()
        due.run_us(20_000.0)
        return due.probe(address).max_instructions


def measure_costs(elf: Path) -> Costs:
    """Fly the firmware through its most expensive flights and count."""
    flights = fly_the_worst(elf)
    ticks = [flight.tick_cost() for flight in flights]
    return Costs(
        tick_instructions_max=max(tick.max_instructions for tick in ticks),
        tick_instructions_mean=sum(tick.instructions for tick in ticks) / sum(tick.count for tick in ticks),
        cascade_instructions_max=max(flight.function_cost(CASCADE).max_instructions for flight in flights),
        encoder_isr_instructions_max=max(
            flight.board.due.exception_stats(TRAVEL_INTERRUPT).max_instructions for flight in flights
        ),
        pid_v1_three_loops_instructions=measure_pid_v1(),
    )


def main() -> None:
    """Print what a firmware costs."""
    parser = argparse.ArgumentParser(description="instructions of the firmware's tick, on the emulated board")
    parser.add_argument("elf", type=Path, help="the linked firmware")
    for name, value in asdict(measure_costs(parser.parse_args().elf)).items():
        print(f"{name:36} {value:8,.0f}")


if __name__ == "__main__":
    main()

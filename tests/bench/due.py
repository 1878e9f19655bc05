"""Cost and speed of the firmware, counted on the emulated board: exact and repeatable."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path
from tempfile import TemporaryDirectory

from firmware.due.report import read_image
from tests.bench.result import Measured
from tests.firmware.cost import LAW_UPDATE, Flight, measure_costs
from tests.firmware.desk import (
    Board,
    boot_to_first_frame_ms,
    longest_off_after_hang_ms,
    rx_lost_bytes,
    travel_counts_lost,
)
from tests.law.flown import fly_and_steer, law_of

ROOT = Path(__file__).resolve().parents[2]


def build(folder: Path) -> Path:
    """Build the firmware and return the ELF."""
    elf = folder / "heli.elf"
    subprocess.run(["make", "-s", "-C", ROOT / "firmware" / "due", f"BUILD={folder}", elf], check=True)
    return elf


def has_cross_compiler() -> bool:
    """Whether the firmware can be built here."""
    return shutil.which("arm-none-eabi-g++") is not None


def law_costs(elf: Path) -> dict[str, float]:
    """Instructions of laws that came over the link, in flight."""
    instructions: dict[str, float] = {}
    for name in ("lqi", "mpc"):
        flight = Flight(elf, read_image(elf), (LAW_UPDATE,))
        fly_and_steer(flight, law_of(ROOT / "docs" / "laws" / f"{name}.py").program, 5.0)
        instructions[f"law_{name}_tick_instructions"] = flight.tick()[2]
        if name == "lqi":
            instructions["law_lqi_instructions"] = flight.function(LAW_UPDATE)[2]
    return instructions


def measure() -> list[Measured]:
    """Count instructions, bytes and milliseconds; needs the cross-compiler."""
    with TemporaryDirectory() as folder:
        elf = build(Path(folder))
        image = read_image(elf)
        costs = measure_costs(elf)
        numbers = {
            "due_tick_instructions_max": costs.tick_instructions_max,
            "due_tick_instructions_mean": costs.tick_instructions_mean,
            "due_cascade_instructions": costs.cascade_instructions_max,
            "due_pid_v1_three_loops_instructions": costs.pid_v1_three_loops_instructions,
            **law_costs(elf),
            "due_encoder_isr_instructions": costs.encoder_isr_instructions_max,
            "due_encoder_lost_counts": travel_counts_lost(Board(elf, image)),
            "due_boot_to_first_frame_ms": boot_to_first_frame_ms(Board(elf, image)),
            "due_rx_lost_bytes": rx_lost_bytes(Board(elf, image)),
            "due_motors_off_after_hang_ms": longest_off_after_hang_ms(elf, image),
        }
    return [Measured(key, [float(value)]) for key, value in numbers.items()]

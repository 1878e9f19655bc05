"""A chip with short programs that drive its peripherals, and the compiled C programs."""

import shutil
import struct
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from due_emulator import Due

PROGRAMS = Path(__file__).resolve().parent / "programs"
Build = Callable[..., Path]


@pytest.fixture(scope="session")
def build(tmp_path_factory: pytest.TempPathFactory) -> Build:
    """Compiles programs of ``programs/`` to ELF files; skips without the cross-compiler."""
    compiler = shutil.which("arm-none-eabi-gcc")
    if compiler is None:
        pytest.skip("arm-none-eabi-gcc is missing: apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi")
    folder = tmp_path_factory.mktemp("programs")

    def compile_program(name: str, *options: str) -> Path:
        output = folder / ("-".join([Path(name).stem, *(o.strip("-") for o in options)]) + ".elf")
        command = [
            compiler, "-mcpu=cortex-m3", "-mthumb", "-g", "-nostartfiles", "-ffreestanding",
            "-T", str(PROGRAMS / "due.ld"), *options, "-o", str(output),
            str(PROGRAMS / "start.S"), str(PROGRAMS / name), "-lm", "-lc", "-lgcc",
        ]  # fmt: skip
        result = subprocess.run(command, capture_output=True, text=True, check=False)
        assert result.returncode == 0, result.stderr
        return output

    return compile_program


FLASH = 0x0008_0000
RAM = 0x2007_0000
FULL_HZ = 84_000_000
# Fields of the PMC's registers CKGR_MOR, CKGR_PLLAR, PMC_MCKR and PMC_SR.
MOR_KEY, MOSCXTEN, MOSCRCEN, MOSCSEL = 0x37 << 16, 1 << 0, 1 << 3, 1 << 24
PLLAR_ONE = 1 << 29
PRES_2, CSS_MAIN, CSS_PLLA = 1 << 4, 1, 2
MOSCXTS, LOCKA, MCKRDY = 1 << 0, 1 << 1, 1 << 3
# reset_handler: wfi; b reset_handler
_PARKED = struct.pack("<II", 0x2008_8000, FLASH + 0x101).ljust(0x100, b"\0") + b"\x30\xbf\xfd\xe7"

PIDS = {
    "UART": 8,
    "PIOA": 11,
    "PIOB": 12,
    "PIOC": 13,
    "PIOD": 14,
    "TC0": 27,
    "TC1": 30,
    "TC2": 33,
    "PWM": 36,
    "ADC": 37,
    "DACC": 38,
    "TRNG": 41,
}


class Chip:
    """A Due whose processor sleeps while the test reads and writes registers."""

    # `full_speed`: Bring the clock to 84 MHz, as firmware does.
    # `clocks`: Peripherals whose clock to switch on.
    # `strict`: As on the command line.

    def __init__(self, *clocks: str, full_speed: bool = True, strict: bool = True) -> None:
        self.due = Due()
        self.due.set_strict(strict)
        self.due.load(FLASH, _PARKED)
        self._address = {name: base + offset for name, base, offset in self._registers()}
        self.power_on(*clocks, full_speed=full_speed)

    def _registers(self) -> list[tuple[str, int, int]]:
        rows = []
        for peripheral, base, name, offset, *_ in self.due.registers():
            tail = name.split("_", 1)[1] if "_" in name else name
            rows.append((f"{peripheral}.{tail}", base, offset))
        return rows

    def power_on(self, *clocks: str, full_speed: bool = True) -> None:
        """Power comes up; the chip runs as far as its program's sleep."""
        self.due.power_on()
        self.due.run_us(200)
        if full_speed:
            self.to_full_speed()
        self.clock(*clocks)

    def to_full_speed(self) -> None:
        """12 MHz crystal, PLLA x 14, half of it."""
        self["EFC0.FMR"] = self["EFC1.FMR"] = 4 << 8
        self["PMC.MOR"] = MOR_KEY | 8 << 8 | MOSCRCEN | MOSCXTEN
        self.wait("PMC.SR", MOSCXTS)
        self["PMC.MOR"] = MOR_KEY | MOSCSEL | 8 << 8 | MOSCRCEN | MOSCXTEN
        self["PMC.MCKR"] = CSS_MAIN
        self.wait("PMC.SR", MCKRDY)
        self["PMC.PLLAR"] = PLLAR_ONE | 13 << 16 | 0x3F << 8 | 1
        self.wait("PMC.SR", LOCKA)
        self["PMC.MCKR"] = PRES_2 | CSS_MAIN
        self.wait("PMC.SR", MCKRDY)
        self["PMC.MCKR"] = PRES_2 | CSS_PLLA
        self.wait("PMC.SR", MCKRDY)

    def clock(self, *names: str) -> None:
        """Switch on the clocks of peripherals; a timer block gets all three of its own."""
        for name in names:
            for pid in range(PIDS[name], PIDS[name] + (3 if name.startswith("TC") else 1)):
                self[f"PMC.PCER{pid // 32}"] = 1 << pid % 32

    def wait(self, register: str, mask: int, most_us: float = 20_000) -> None:
        """Let time pass until any bit of the mask is set."""
        end_us = self.due.now_us + most_us
        while not self[register] & mask:
            assert self.due.now_us < end_us, f"{register} never showed {mask:#x}"
            self.due.run_us(10)

    def run_cycles(self, count: int) -> None:
        """Let so many cycles of 84 MHz pass."""
        self.due.run_us(count / 84)

    def __getitem__(self, register: str) -> int:
        return self.due.read_word(self._address[register])

    def __setitem__(self, register: str, value: int) -> None:
        self.due.poke(self._address[register], struct.pack("<I", value & 0xFFFF_FFFF))

    def store(self, address: int, value: int) -> None:
        """A store of a word by the processor, to flash latches for example."""
        self.due.write_word(address, value)

    def word(self, address: int) -> int:
        """A word of memory."""
        return int.from_bytes(self.due.peek(address, 4), "little")

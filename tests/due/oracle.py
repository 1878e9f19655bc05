"""unicorn as the oracle of the processor: the same code in both, compared before every instruction."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from due_emulator import BareCore
from numpy.typing import NDArray

FLASH, FLASH_SIZE = 0x0008_0000, 0x8_0000
RAM, RAM_SIZE = 0x2007_0000, 0x1_8000
FLAGS = 0xF800_0000
_CHUNK = 5000
_NAMES = [*(f"r{i}" for i in range(13)), "sp", "lr", "pc", "xpsr"]


class Oracle:
    """Both processors, with the same memory.

    Parameters
    ----------
    core
        The emulator under test.
    """

    def __init__(self) -> None:
        unicorn = pytest.importorskip("unicorn", reason="unicorn is missing: pip install unicorn")
        self._arm: Any = pytest.importorskip("unicorn.arm_const")
        self.core = BareCore()
        self._uc: Any = unicorn.Uc(unicorn.UC_ARCH_ARM, unicorn.UC_MODE_THUMB | unicorn.UC_MODE_MCLASS)
        self._uc.ctl_set_cpu_model(self._arm.UC_CPU_ARM_CORTEX_M3)
        self._uc.mem_map(FLASH, FLASH_SIZE)
        self._uc.mem_map(RAM, RAM_SIZE)
        self._registers = [self._arm.UC_ARM_REG_R0 + i for i in range(13)]
        self._registers += [self._arm.UC_ARM_REG_SP, self._arm.UC_ARM_REG_LR]
        self._registers += [self._arm.UC_ARM_REG_PC, self._arm.UC_ARM_REG_CPSR]
        self._rows: list[tuple[int, ...]] = []
        self._most = 0
        self.compared = 0
        self._uc.hook_add(unicorn.UC_HOOK_CODE, self._before)

    def write(self, address: int, data: bytes) -> None:
        """Put the same bytes into both."""
        self._uc.mem_write(address, data)
        self.core.write(address, data)

    def forget_code(self) -> None:
        """Code that unicorn has translated was overwritten."""
        self._uc.ctl_flush_tb()

    def set_registers(self, values: list[int], flags: int) -> None:
        """r0 to r12, SP, LR and the flags of APSR."""
        for index, value in enumerate(values):
            self._uc.reg_write(self._registers[index], value)
            self.core.set_reg(index, value)
        self._uc.reg_write(self._registers[16], flags | 1 << 24)
        self.core.set_apsr(flags)

    def run(self, start: int, stop: int, most: int = 10**9) -> None:
        """Run both from ``start`` until PC is ``stop``, or until ``most`` instructions were compared."""
        self.core.set_reg(15, start)
        self._rows.clear()
        self._most = self.compared + most
        self._uc.emu_start(start | 1, stop)
        if self.compared < self._most:
            self._rows.append(self._uc.reg_read_batch(self._registers))
            self._compare(stop)

    def memory_is_equal(self) -> bool:
        """SRAM, byte by byte."""
        return self.core.read(RAM, RAM_SIZE) == bytes(self._uc.mem_read(RAM, RAM_SIZE))

    def _before(self, uc: Any, _address: int, _size: int, _data: Any) -> None:
        self._rows.append(uc.reg_read_batch(self._registers))
        if len(self._rows) > _CHUNK:
            self._compare(0xFFFF_FFFE)
            if self.compared >= self._most:
                uc.emu_stop()

    def _compare(self, stop: int) -> None:
        # unicorn has no row for an instruction that an IT block skips, and neither has the trace.
        wanted = np.array(self._rows, dtype=np.uint64).astype(np.uint32)
        traced: NDArray[np.uint32] = self.core.trace(stop, len(wanted) - 1)
        traced = traced[: len(wanted)].copy()
        assert len(traced) == len(wanted), "the two took different ways"
        wanted[:, 16] &= FLAGS
        traced[:, 16] &= FLAGS
        different = np.nonzero((wanted != traced).any(axis=1))[0]
        if len(different):
            self._explain(int(different[0]), wanted, traced)
        self.compared += len(wanted) - 1
        self._rows = self._rows[-1:]

    def _explain(self, row: int, wanted: NDArray[np.uint32], traced: NDArray[np.uint32]) -> None:
        at = int(wanted[max(row - 1, 0), 15])
        code = bytes(self._uc.mem_read(at, 4)).hex()
        lines = [
            f"{name}: {int(traced[row, i]):#010x}, unicorn has {int(wanted[row, i]):#010x}"
            for i, name in enumerate(_NAMES)
            if traced[row, i] != wanted[row, i]
        ]
        pytest.fail(f"after {self.compared + row} instructions, behind {code} at {at:#x}: {'; '.join(lines)}")

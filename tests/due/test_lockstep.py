"""The interpreter and unicorn agree after every instruction, on random code and on compiled programs."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from due_emulator import read_image

from tests.due.conftest import Build
from tests.due.oracle import FLASH, FLASH_SIZE, RAM, RAM_SIZE, Oracle
from tests.due.thumb import ENCODINGS, random_block
from tests.running.long import samples

RANDOM_INSTRUCTIONS = samples(500_000, 60_000)
COMPILED_INSTRUCTIONS = samples(125_000, 20_000)
SEED = 20_240_611
_CODE_FIRST, _CODE_LAST = FLASH + 0x1_0000, FLASH + 0x7_0000
_INTERESTING = (0, 1, 0x7FFF_FFFF, 0x8000_0000, 0xFFFF_FFFF)


@pytest.mark.emulated
def test_random_instructions_agree() -> None:
    rng = random.Random(SEED)
    oracle = Oracle()
    oracle.write(FLASH, rng.randbytes(FLASH_SIZE))
    oracle.write(RAM, rng.randbytes(RAM_SIZE))
    address = _CODE_FIRST
    observed: set[str] = set()
    while oracle.compared < RANDOM_INSTRUCTIONS:
        block = random_block(rng)
        if address + len(block.code) > _CODE_LAST:
            address = _CODE_FIRST
            oracle.forget_code()
        oracle.write(address, block.code + b"\x00\xbf\x00\xbf")
        for _ in range(2):
            registers = [
                rng.choice(_INTERESTING)
                if rng.random() < 0.3
                else rng.getrandbits(rng.choice((4, 8, 16, 32)))
                for _ in range(15)
            ]
            registers[13] = RAM + 0xC000
            registers[block.base] = RAM + 0x8000 + 4 * rng.randrange(64)
            registers[block.index] = 4 * rng.randrange(64)
            oracle.set_registers(registers, rng.getrandbits(5) << 27)
            oracle.run(address, address + len(block.code))
        observed.update(block.names)
        address += len(block.code) + 64
    print(f"seed {SEED}: {oracle.compared} random instructions, {len(observed)} encodings, no difference")
    assert observed >= {encoding.name for encoding in ENCODINGS}
    assert oracle.memory_is_equal()


@pytest.mark.emulated
@pytest.mark.parametrize("options", [("-O0",), ("-Os",), ("-O2",), ("-O3", "-funroll-loops")])
def test_compiled_programs_agree(build: Build, options: tuple[str, ...]) -> None:
    image = read_image(Path(build("compute.c", *options)))
    oracle = Oracle()
    oracle.write(RAM, bytes(RAM_SIZE))
    for address, data in image.segments:
        oracle.write(address, data)
    oracle.set_registers([0] * 13 + [RAM + RAM_SIZE, 0xFFFF_FFFF], 0)
    oracle.run(image.address("reset"), image.address("finished"), COMPILED_INSTRUCTIONS)
    print(f"{' '.join(options)}: {oracle.compared} compiled instructions, no difference")
    assert oracle.compared >= COMPILED_INSTRUCTIONS
    assert oracle.memory_is_equal()

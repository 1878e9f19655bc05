"""Claims about the emulated Due, each against a witness that is not the emulator.

Unicorn for the instructions (random ones from the table in `thumb.py`, and compiled programs), the vendor's
register description for names, offsets and reset values, the architecture manual's rules for exceptions
(`programs/exceptions.S` and the traces it must leave), the datasheet's formulas for PWM, UART, timers and
quadrature.

Peripherals are driven from Python through `chip.py`, with the processor parked: no compiler needed.

Programs are built with `arm-none-eabi-gcc`; without it these tests skip, and say so.

The register description comes from PyPI: `python tests/due/fetch_svd.py` (35 MB, once, into `build/svd`);
without it that test skips.
"""

"""Claims about the emulated Due. No witness is the emulator itself:

- Unicorn for instructions: random ones from the table in `thumb.py`, and compiled programs;
- the vendor's register description for names, offsets and reset values;
- the architecture manual for exceptions: `programs/exceptions.S` and the traces that it must leave;
- formulas of the datasheet for PWM, UART, timers and quadrature.

`chip.py` drives peripherals from Python, with the processor halted, so that these tests need no compiler.
The programs are built with `arm-none-eabi-gcc`. `python tests/due/fetch_svd.py` gets the register
description from PyPI (35 MB, once, into `build/svd`). Without either, tests skip with that reason.
"""

"""``python -m due_emulator ELF``: run any program for the Due and copy UART0 to stdout.

Exit codes:

- 0: the time is over;
- 1: a HardFault or a lockup;
- 2: bad arguments;
- 3: the emulator stopped in strict mode;
- 4: lenient mode found a loop that waits for a register which never changes.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from due_emulator._due import Due, Stop
from due_emulator.errors import EmulatorError
from due_emulator.gdb import GdbServer
from due_emulator.image import read_image
from due_emulator.machine import new_due, report_of

EXIT_DONE = 0
EXIT_FAULT = 1
EXIT_USAGE = 2
EXIT_STRICT = 3
EXIT_WAIT = 4

_SLICE_US = 1000.0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m due_emulator",
        description="Run a program for the Arduino Due on the emulated chip; UART0 goes to stdout.",
    )
    parser.add_argument("program", metavar="ELF", help="ELF or .bin for the SAM3X8E")
    parser.add_argument("--seconds", type=float, default=1.0, metavar="S", help="board time (default 1)")
    parser.add_argument(
        "--lenient",
        action="store_true",
        help="print a warning instead of stopping at an error that a real chip hides",
    )
    parser.add_argument(
        "--ride-faults", action="store_true", help="let the program's own HardFault handler run"
    )
    parser.add_argument("--baud", type=int, default=250000, help="baud rate of the USB side (default 250000)")
    parser.add_argument("--gdb", type=int, metavar="PORT", help="wait for a debugger on this TCP port")
    return parser


def _copy_output(due: Due) -> None:
    data = due.usb_read()
    if data:
        sys.stdout.buffer.write(data)
        sys.stdout.buffer.flush()
    for warning in due.take_warnings():
        print(f"warning: {warning}", file=sys.stderr)


def _run(due: Due, end_us: float) -> None:
    while due.now_us < end_us and not due.halt:
        due.run_us(min(_SLICE_US, end_us - due.now_us + 0.1))
        _copy_output(due)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line of `arguments` without the program's name, or of this process if None."""
    options = _parser().parse_args(arguments)
    try:
        image = read_image(options.program)
        due = new_due(image, strict=not options.lenient)
        due.stop_at_hardfault(not options.ride_faults)
        due.usb_line_coding(options.baud)
        due.power_on()
        if options.gdb is not None:
            GdbServer(due, image).serve(options.gdb)
            _copy_output(due)
            return EXIT_DONE
        _run(due, due.now_us + options.seconds * 1e6)
    except Stop as stop:
        _copy_output(due)
        print(f"error after {due.now_us / 1e3:.3f} ms: {stop}\n{report_of(due)}", file=sys.stderr)
        if due.halt:
            return EXIT_FAULT
        return EXIT_WAIT if options.lenient and str(stop).startswith("wait:") else EXIT_STRICT
    except EmulatorError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_USAGE
    if due.halt:
        print(f"{due.halt} after {due.now_us / 1e3:.3f} ms\n{report_of(due)}", file=sys.stderr)
        return EXIT_FAULT
    return EXIT_DONE


if __name__ == "__main__":
    sys.exit(main())

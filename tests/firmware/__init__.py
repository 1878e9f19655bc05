"""Claims about the Due's firmware.

Registers against the vendor's description, the linked program against its bounds, and the program running
on the emulated board. Tests skip, and say why, without `arm-none-eabi-g++`, without the emulator's
extension, or without the vendor's description, which `python tests/due/fetch_svd.py` puts into `build/svd`.
`test_mutations.py` makes one mistake of `mutations.py` (registers) or `subtle_mutations.py` (filters, lock
times, traps, order, races; the core's too) at a time and expects the claim beside it to fail: whoever
changes a driver adds one. `hangs.py` are ways to hang in flight, `measures.py` what tests and bench both
measure. `desk.py` is the emulated board with the arm on its pins and a host on its port; `description.py`
reads the vendor's file. `cost.py` counts instructions over the most expensive flights: `python -m
tests.firmware.cost ELF`; `pid_v1.cpp` is there for scale. `test_call_graph.py` holds what
`firmware/due/report.py` reads from machine code against `calls.cpp` and `calls.s`, which call in every way.
"""

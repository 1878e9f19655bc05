"""Claims about the firmware of the Due.

Tests compare registers with the vendor's description, the linked program with its bounds, and the program
on the emulated board with what it must do. They skip with a reason without `arm-none-eabi-g++`, without the
emulator's extension, or without the vendor's description in `build/svd` (`python tests/due/fetch_svd.py`).

| file | content |
|---|---|
| `mutations.py`, `subtle_mutations.py` | mistakes, each with a test that must fail |
| `hangs.py` | ways to hang in flight |
| `measures.py` | measurements that tests and bench share |
| `desk.py` | the emulated board with a rig on its pins and a host on its port |
| `description.py` | reader of the vendor's file |
| `cost.py` | instructions in the most expensive flights, `python -m tests.firmware.cost ELF` |
| `pid_v1.cpp` | Arduino's PID library, for comparison |
| `calls.cpp`, `calls.s` | every kind of call, for the call graph of `firmware/due/report.py` |
"""

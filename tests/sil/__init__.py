"""Claims about the simulated board and its serial ports.

Timing of the line, determinism, faults, clock, and ports that survive their host. No test looks at the
clock on the wall. Tests ask the simulated clock what it would do at given times, and wait for what servers
do.

| file | content |
|---|---|
| `harness.py` | hosts that speak to the board in frames, and boards that wait for a computer that stalls |
| `faulty_flights.py` | flights drawn by seed, in which something fails |
| `conftest.py` | builds the ELF file, and gives either board to a test |
"""

"""Claims about the simulated board and its serial ports.

Timing of the line, determinism, faults, ports that survive their host, and clock. Nothing here measures the
clock on the wall: the simulated clock is asked what it would do at given times, and servers are waited for
by what they do. `harness.py` speaks to the board in frames. `patient.py`: boards that wait for a machine
that stalls. `faulty_flights.py` is a seeded set of flights to which something happens. `conftest.py` builds
the ELF and gives either board to a test.
"""

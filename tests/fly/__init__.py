"""Claims about plans, and about flying them.

`test_plan.py` needs no board; `test_runner.py` flies the simulated one, in lockstep where time is simulated
and the same flight gives the same log byte for byte, and twice over a pseudo-terminal as over hardware.
`fault_flights.py` lets something fail at a known millisecond, `fault_table.py` has what, and prints the
table of docs/reference/failures.md, which `test_fault_table.py` holds to it. `fault_sweep.py` lets encoders
and supply fail at any moment, on rigs with gains of `tune` from `gains/`, compares the report with the true
state, and prints the other table; it also counts false alarms of healthy rigs. `test_fault_sweep.py` flies
a share of both. `test_lost_axes.py`: no healthy flight is taken for one with a plug off. `encoder_scale.py`
flies rigs with a wrong encoder and counts warnings; `test_encoder_scale.py` a share of it.
`test_restart.py` takes the board's power away in flight. `test_disk.py`: disks that block, fill up, or hold
a log already.

Every way in which a flight can end is flown here: completed, fault, Ctrl-C once and twice, unplugged for a
moment, for long and for ever, a full disk, an error in the caller's own code, a killed host. Does not
belong here: the link's own tests (`tests/link`), control quality (`tests/control`).
"""

"""Claims about plans, and about flying them.

Every end of a flight is flown: completed, fault, Ctrl-C once and twice, unplugged for a moment, for long
and for ever, a full disk, an error in the caller's code, a killed host. Most flights use a simulated board
in lockstep, where the same flight gives the same log byte for byte. Two use a pseudo-terminal, as hardware
would.

| file | content |
|---|---|
| `fault_flights.py`, `fault_table.py` | one failure at a known time; the table of failures.md |
| `fault_sweep.py` | encoders and supply fail at any moment on many rigs; false alarms of healthy rigs |
| `encoder_scale.py` | rigs with a wrong encoder, and the warnings that they give |
| `test_lost_axes.py` | no healthy flight counts as one with an unplugged encoder |
| `test_restart.py` | the board loses its power in flight |
| `test_disk.py` | disks that block, fill up, or have a log of this name |

Does not belong here: the link (`tests/link`), quality of control (`tests/control`).
"""

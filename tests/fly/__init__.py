"""Claims about plans, and about flying them.

Every end of a flight is flown: completed, fault, Ctrl-C once and twice, unplugged for a moment, for long
and for ever, a full disk, an error in the caller's code, a killed host. Most flights use a simulated board
in lockstep, where the same flight gives the same log byte for byte. Two use a pseudo-terminal, as hardware
would.

Does not belong here: the link (`tests/link`), quality of control (`tests/control`).
"""

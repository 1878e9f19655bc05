"""Claims about the supervisor: who may start the motors, what stops them, and when.

`harness.py` runs the whole flight code: the test owns the encoders, the clock and the serial bytes, and
speaks to it in frames like any host. `test_drives.py` has boards with other numbers
than the Due's, too. No plant here: the angles are what the test says they are.
"""

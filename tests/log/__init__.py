"""Claims about logs, tables, exports, figures and summaries, without any board.

`made.py` makes flights by formula, `fuzz_log.py` damages them.

Witnesses: the `mcap` library's own readers (by index and by stream, with CRCs), a ROS 2 decoder that knows
only the schema, and the measured flights beside the checkout where they are present. Damage is part of the
room: files cut at any byte, bytes changed in every way that `mutate.py` knows, a writer killed by `kill
-9`, a disk that fills up.
"""

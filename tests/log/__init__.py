"""Claims about logs, tables, exports, figures and summaries, without any board.

`made.py` makes flights by formula, and `fuzz_log.py` damages them: files cut at any byte, bytes changed, a
writer ended by `kill -9`, a full disk. Witnesses are the readers of the `mcap`
library, by index and by stream with checksums, a ROS 2 decoder that knows only the schema, and measured
flights if the shared data is available.
"""

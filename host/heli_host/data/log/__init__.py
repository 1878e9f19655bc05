"""A flight on disk: `writer.LogWriter` writes a log, `reader.read_flight` reads it.

Of `heli_host.link`, only `channels` is imported: a flight can be analysed on a computer without a board.

Does not belong here: ports, sessions, plans, anything that waits.
"""

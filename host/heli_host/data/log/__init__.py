"""A flight on disk: `writer.LogWriter` writes a log, `reader.read_flight` reads it.

This package imports only `channels` of `heli_host.link`, so that a flight can be analysed without a board.

Does not belong here: ports, sessions, plans, anything that waits.
"""

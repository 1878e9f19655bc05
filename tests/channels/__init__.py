"""A telemetry channel, from its declaration to every table.

What must hold whichever channels are declared, in whatever order and of whatever types.

Does not belong here: the position or the number of a channel.
"""

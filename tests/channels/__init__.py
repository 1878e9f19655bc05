"""A telemetry channel, from its declaration to every table.

Claims that hold for all declarations of channels, in any order and of any types.

Does not belong here: the position or the number of a channel.
"""

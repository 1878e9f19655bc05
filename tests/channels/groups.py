"""Telemetry channels in groups, for tests that make rows of raw numbers or take them apart."""

from heli_host.declaration import AXES, CHANNELS, Channel
from heli_host.link.channels import ENCODERS

COUNTS: list[Channel] = list(ENCODERS)
"""Encoders, in the order of the axes."""
SETPOINTS = [Channel[f"{axis}_setpoint".upper()] for axis in AXES]
VOLTAGES = [Channel.FRONT, Channel.BACK]
STATUS = [Channel.STATE, Channel.FAULT, Channel.FLAGS]
UNSIGNED = [channel for channel in Channel if CHANNELS[channel].code.isupper()]
SIGNED = [channel for channel in Channel if channel not in UNSIGNED]


def row_of(values: dict[Channel, int]) -> list[int]:
    """Raw numbers of one tick, in the declaration's order; 0 for channels that are not named."""
    return [values.get(channel, 0) for channel in Channel]

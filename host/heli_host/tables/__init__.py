"""Files from other programs: read as tables, and converted to flights by a profile."""

from heli_host.tables.convert import flights_of
from heli_host.tables.profile import (
    Angle,
    Part,
    Profile,
    Voltage,
    profile_of,
    profile_text,
    read_entries,
    read_profile,
)
from heli_host.tables.read import KINDS, read_table
from heli_host.tables.table import Column, Table

__all__ = [
    "KINDS",
    "Angle",
    "Column",
    "Part",
    "Profile",
    "Table",
    "Voltage",
    "flights_of",
    "profile_of",
    "profile_text",
    "read_entries",
    "read_profile",
    "read_table",
]

"""Files from other programs: read as tables, and converted to flights by a profile.

`read_table` reads a file, a `Profile` describes its columns, and `flights_of` makes flights from both.

Does not belong here: guesses about columns, which need a model; the logs of this package.
"""

from heli_host.data.tables.convert import Conversion, convert, flights_of
from heli_host.data.tables.profile import (
    Angle,
    Part,
    Profile,
    Voltage,
    profile_of,
    profile_text,
    read_entries,
    read_profile,
)
from heli_host.data.tables.read import KINDS, read_table
from heli_host.data.tables.table import Column, RowChange, Table

__all__ = [
    "KINDS",
    "Angle",
    "Column",
    "Conversion",
    "Part",
    "Profile",
    "RowChange",
    "Table",
    "Voltage",
    "convert",
    "flights_of",
    "profile_of",
    "profile_text",
    "read_entries",
    "read_profile",
    "read_table",
]

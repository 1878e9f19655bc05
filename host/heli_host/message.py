"""Base classes of what `heli_host.declaration` declares: names, and messages as bytes."""

from __future__ import annotations

import struct
from enum import IntEnum
from typing import ClassVar, Self


class Name(IntEnum):
    """A declared number, which prints as its name in link.toml."""

    def __str__(self) -> str:
        return self.name.lower()


class Message:
    """A message of the link: a dataclass whose fields have the layout of `STRUCT`, in order."""

    __slots__: tuple[str, ...] = ()
    ID: ClassVar[IntEnum]
    STRUCT: ClassVar[struct.Struct]

    def pack(self) -> bytes:
        """Return the payload bytes."""
        return self.STRUCT.pack(*(getattr(self, name) for name in self.__slots__))

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """Read the fixed fields from the start of ``payload``."""
        return cls(*cls.STRUCT.unpack_from(payload))

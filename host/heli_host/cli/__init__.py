"""The ``heli-host`` command."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from heli_host.cli.entry import app, main, run

__all__ = ["app", "main", "run"]


def __getattr__(name: str) -> Any:
    # The entry loads the verbs of all packages, which import from here: who needs an option needs none.
    if name in __all__:
        from heli_host.cli import entry

        return getattr(entry, name)
    raise AttributeError(f"module {__name__} has no attribute {name}")

"""The ``heli-host`` command."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any, NoReturn

if TYPE_CHECKING:
    from heli_host.ui.cli.entry import app, run

__all__ = ["app", "main", "run"]

_EXIT_INTERRUPTED = 130


def main() -> NoReturn:
    """Run the command line; ends the process. A Ctrl-C while the program still loads is no traceback."""
    try:
        from heli_host.ui.cli import entry

        entry.main()
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(_EXIT_INTERRUPTED)


def __getattr__(name: str) -> Any:
    # The entry loads the verbs of all packages, which import from here: who needs an option needs none.
    if name in __all__:
        from heli_host.ui.cli import entry

        return getattr(entry, name)
    raise AttributeError(f"module {__name__} has no attribute {name}")

"""The ``heli-host`` command."""

from __future__ import annotations

from heli_host.cli.entry import app, main, run

__all__ = ["app", "main", "run"]

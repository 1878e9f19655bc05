"""Optional parts of the package, by the name of the extra that installs what they need."""

from __future__ import annotations

import importlib.metadata
import re
from collections.abc import Mapping
from typing import Final

from heli_host.ui.cli.verb import DISTRIBUTION

USERS_EXTRAS: Final[Mapping[str, str]] = {
    "page": "the dashboard",
    "import": "spreadsheets, Parquet files and ROS bags",
    "export": "logs as Parquet",
    "foxglove": "live samples for Foxglove and PlotJuggler",
    "gym": "the Gymnasium environment",
    "campaign": "campaigns on several computers",
    "benchmark": "the benchmark of hidden causes, with other methods",
}
"""Extras that users choose, and their purpose. Other extras are for developers."""


def packages_of(extra: str) -> tuple[str, ...]:
    """Return the names of the packages that an extra installs."""
    lines = importlib.metadata.requires(DISTRIBUTION) or []
    marker = re.compile(rf"extra == ['\"]{re.escape(extra)}['\"]")
    return tuple(re.split(r"[^\w.-]", line, maxsplit=1)[0] for line in lines if marker.search(line))


def needs(package: str) -> bool:
    """Return whether heli-host itself needs a package."""
    lines = importlib.metadata.requires(DISTRIBUTION) or []
    names = {re.split(r"[^\w.-]", line, maxsplit=1)[0].lower() for line in lines if "extra ==" not in line}
    return package.partition(".")[0].lower() in names


def extra_with(package: str) -> str | None:
    """Return the users' extra that installs a package, or None."""
    top_level = package.partition(".")[0].lower()
    for extra in USERS_EXTRAS:
        if top_level in (name.lower() for name in packages_of(extra)):
            return extra
    return None

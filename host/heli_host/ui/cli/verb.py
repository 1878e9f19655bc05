"""A verb of the command line, and the search for all installed verbs.

A verb is a module with a `VERB`. Verbs are looked for in every module of the packages that the entry-point
group ``heli_host.verbs`` names: this package, the simulation, the laboratory, and other installed
packages.
"""

from __future__ import annotations

import importlib
import pkgutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import EntryPoint
from typing import Any, Final

import typer

from heli_host.link.installation import plugins
from heli_host.ui.cli.variadic import Variadic

ENTRY_POINT_GROUP: Final = "heli_host.verbs"
DISTRIBUTION: Final = "heli-host"
PANELS: Final = ("Fly", "Board", "Logs", "Simulation", "Laboratory")
"""Headings of ``--help``, in this order; others come after them."""


@dataclass(frozen=True)
class Verb:
    """One verb."""

    command: Callable[..., Any] | typer.Typer
    """A function whose signature holds options as typer reads them, or several under one name."""
    panel: str  # Heading of ``--help`` that lists the verb
    variadic: bool = False
    """Whether its repeatable options take several words each, see `Variadic`; functions only."""
    aliases: tuple[str, ...] = ()  # Other names, which ``--help`` does not list; functions only

    def add_to(self, app: typer.Typer, name: str) -> None:
        """Make it the verb `name` of a command line, `app`."""
        if isinstance(self.command, typer.Typer):
            app.add_typer(self.command, name=name, rich_help_panel=self.panel)
        elif self.variadic:
            app.command(name, cls=Variadic, rich_help_panel=self.panel)(self.command)
        else:
            app.command(name, rich_help_panel=self.panel)(self.command)
            for alias in self.aliases:
                app.command(alias, hidden=True)(self.command)


def installed_verbs() -> dict[str, Verb]:
    """Find the verbs of all installed packages, ordered by panel, then by name.

    The name of a verb is that of its module. If a package cannot be imported, a line on stderr reports it,
    and the verbs of other packages still work.
    """
    verbs: dict[str, Verb] = {}
    for entry in sorted(plugins(ENTRY_POINT_GROUP), key=_own_packages_first):
        try:
            for name, verb in _verbs_in(entry.value):
                if verbs.setdefault(name, verb) is not verb:
                    _warn(f"{entry.value} has another verb '{name}'")
        except Exception as error:  # noqa: BLE001  -- whatever a stranger's package raises when it is imported
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            _warn(f"the verbs of {entry.value} do not load ({reason})")
    rank = {panel: index for index, panel in enumerate(PANELS)}
    return dict(sorted(verbs.items(), key=lambda item: (rank.get(item[1].panel, len(rank)), item[0])))


def _warn(cause: str) -> None:
    from heli_host.errors import printable

    print(f"warning: {printable(cause)}; left out", file=sys.stderr)


def _own_packages_first(entry: EntryPoint) -> tuple[bool, str]:
    """Sort key that puts packages of this distribution first, so that others cannot take a verb's name."""
    return entry.dist is None or entry.dist.name != DISTRIBUTION, entry.value


def _verbs_in(package_name: str) -> Iterator[tuple[str, Verb]]:
    """Yield the verbs of a package and of its modules, each with the name of its module."""
    package = importlib.import_module(package_name)
    modules = [package]
    for info in pkgutil.iter_modules(getattr(package, "__path__", ())):
        modules.append(importlib.import_module(f"{package_name}.{info.name}"))
    for module in modules:
        verb = getattr(module, "VERB", None)
        if isinstance(verb, Verb):
            # The verb import is in import_.py, because import is a reserved word of Python.
            yield module.__name__.rpartition(".")[2].rstrip("_"), verb

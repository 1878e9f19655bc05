"""Declares a verb of the command line, gives it groups of options, and finds all installed verbs.

A module declares its verb as `VERB`, which is named after the module, or several as `VERBS`, by name. Verbs
are looked for in every module of the packages that the entry-point group ``heli_host.verbs`` names: this
package, the simulation, the laboratory, and other installed packages.
"""

from __future__ import annotations

import functools
import importlib
import inspect
import pkgutil
import sys
from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, fields, is_dataclass
from importlib.metadata import EntryPoint
from typing import Annotated, Any, Final, get_origin, get_type_hints

import typer
from typer.core import TyperCommand

from heli_host.link.installation import plugins

ENTRY_POINT_GROUP: Final = "heli_host.verbs"
DISTRIBUTION: Final = "heli-host"
_PANELS: Final = ("Fly", "Board", "Logs", "Simulation", "Laboratory")
"""Headings of ``--help``, in this order; others come after them."""


@dataclass(frozen=True)
class Verb:
    """One verb."""

    command: Callable[..., Any] | typer.Typer
    """A function whose signature holds options as typer reads them, or several under one name."""
    panel: str  # Heading of ``--help`` that lists the verb
    variadic: bool = False
    """Whether its repeatable options take several words each, see `_Variadic`; functions only."""
    aliases: tuple[str, ...] = ()  # Other names, which ``--help`` does not list; functions only

    def add_to(self, app: typer.Typer, name: str) -> None:
        """Make it the verb `name` of a command line, `app`."""
        if isinstance(self.command, typer.Typer):
            app.add_typer(self.command, name=name, rich_help_panel=self.panel)
        elif self.variadic:
            app.command(name, cls=_Variadic, rich_help_panel=self.panel)(self.command)
        else:
            app.command(name, rich_help_panel=self.panel)(self.command)
            for alias in self.aliases:
                app.command(alias, hidden=True)(self.command)


def installed_verbs() -> dict[str, Verb]:
    """Find the verbs of all installed packages, ordered by panel, then by name."""
    # If a package cannot be imported, a line on stderr reports it, and the verbs of other packages still
    # work.
    verbs: dict[str, Verb] = {}
    for entry in sorted(plugins(ENTRY_POINT_GROUP), key=_own_packages_first):
        try:
            for name, verb in _verbs_in(entry.value):
                if verbs.setdefault(name, verb) is not verb:
                    _warn(f"{entry.value} has another verb '{name}'")
        except Exception as error:  # noqa: BLE001  -- whatever a stranger's package raises when it is imported
            reason = " ".join(f"{type(error).__name__}: {error}".split())
            _warn(f"the verbs of {entry.value} do not load ({reason})")
    rank = {panel: index for index, panel in enumerate(_PANELS)}
    return dict(sorted(verbs.items(), key=lambda item: (rank.get(item[1].panel, len(rank)), item[0])))


def _warn(cause: str) -> None:
    from heli_host.errors import printable

    print(f"warning: {printable(cause)}; left out", file=sys.stderr)


def _own_packages_first(entry: EntryPoint) -> tuple[bool, str]:
    """Sort key that puts packages of this distribution first, so that others cannot take a verb's name."""
    return entry.dist is None or entry.dist.name != DISTRIBUTION, entry.value


def _verbs_in(package_name: str) -> Iterator[tuple[str, Verb]]:
    """Yield the verbs of a package and of its modules, by name."""
    package = importlib.import_module(package_name)
    modules = [package]
    for info in pkgutil.iter_modules(getattr(package, "__path__", ())):
        modules.append(importlib.import_module(f"{package_name}.{info.name}"))
    for module in modules:
        verb = getattr(module, "VERB", None)
        if isinstance(verb, Verb):
            # The verb import is in import_.py, because import is a reserved word of Python.
            yield module.__name__.rpartition(".")[2].rstrip("_"), verb
        yield from getattr(module, "VERBS", {}).items()


_Verb = Callable[..., None]


def with_option_groups(*, without: Collection[str] = ()) -> Callable[[_Verb], _Verb]:
    """Give a verb the options of its groups, where typer expects one parameter per option."""
    # A group is a keyword argument whose type is a dataclass. Its options are the fields with annotated
    # types, in their order. The other fields keep their defaults.

    def decorate(verb: _Verb) -> _Verb:
        parameters: list[inspect.Parameter] = []
        # By the name of the keyword argument: its dataclass, and the names of its options.
        groups: dict[str, tuple[type[Any], list[str]]] = {}
        for parameter in inspect.signature(verb, eval_str=True).parameters.values():
            group = parameter.annotation
            if isinstance(group, type) and is_dataclass(group):
                options = [option for option in _options_of_dataclass(group) if option.name not in without]
                groups[parameter.name] = group, [option.name for option in options]
                parameters += options
            else:
                parameters.append(parameter.replace(kind=inspect.Parameter.KEYWORD_ONLY))

        @functools.wraps(verb)
        def command(**values: Any) -> None:
            for name, (group, option_names) in groups.items():
                values[name] = group(**{option: values.pop(option) for option in option_names})
            verb(**values)

        # Typer reads the signature from this attribute, which types of functions do not have.
        command.__signature__ = inspect.Signature(parameters)  # type: ignore[attr-defined]
        command.__annotations__ = {parameter.name: parameter.annotation for parameter in parameters}
        return command

    return decorate


def _options_of_dataclass(group: type[Any]) -> list[inspect.Parameter]:
    """Return the options of a dataclass as parameters of a function."""
    types = get_type_hints(group, include_extras=True)
    return [
        inspect.Parameter(
            field.name, inspect.Parameter.KEYWORD_ONLY, default=field.default, annotation=types[field.name]
        )
        for field in fields(group)
        if get_origin(types[field.name]) is Annotated
    ]


class _Variadic(TyperCommand):
    """A verb whose repeatable options take all words up to the next option."""

    # Without this, a second file behind ``--validate`` would be taken for one more flight to fit, without an
    # error.

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Repeat an option before each of its values in `args`, then parse the arguments as usual."""
        repeatable = [option for option in self.params if getattr(option, "multiple", False)]
        names = frozenset(name for option in repeatable for name in option.opts)
        return list(super().parse_args(ctx, spread(args, names)))


def spread(arguments: list[str], repeatable: frozenset[str]) -> list[str]:
    """Repeat each option whose name is in `repeatable` before each of its values in `arguments`; behind
    ``--`` nothing changes.
    """
    result: list[str] = []
    option = ""
    values = 0
    for number, word in enumerate(arguments):
        if word == "--":
            return result + arguments[number:]
        if word.startswith("-") and not _is_number(word):
            option, values = (word, 0) if word in repeatable else ("", 0)
            result.append(word)
            continue
        if option and values:
            result.append(option)
        values += 1
        result.append(word)
    return result


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True

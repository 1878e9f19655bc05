"""Every public function, class and argument of all packages is documented, in numpydoc."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
from collections.abc import Callable, Iterator
from enum import Enum
from types import ModuleType
from typing import Any, get_type_hints

import pytest

PACKAGES = ("heli_host", "heli_sim", "heli_lab")
GENERATED = {"heli_host.declaration"}
SECTION = re.compile(r"^(\w[\w ]*)\n-{3,}$", re.MULTILINE)
NOT_ARGUMENTS = {"self", "cls"}


def public_modules() -> Iterator[ModuleType]:
    for package_name in PACKAGES:
        package = importlib.import_module(package_name)
        yield package
        for info in pkgutil.walk_packages(package.__path__, package_name + "."):
            if info.name in GENERATED or any(part.startswith("_") for part in info.name.split(".")):
                continue
            yield importlib.import_module(info.name)


def public_things() -> Iterator[tuple[str, Any]]:
    """Functions, classes and methods, each where it is defined."""
    for module in public_modules():
        for name, thing in vars(module).items():
            if name.startswith("_") or getattr(thing, "__module__", None) != module.__name__:
                continue
            if inspect.isfunction(thing):
                yield f"{module.__name__}.{name}", thing
            elif inspect.isclass(thing):
                yield f"{module.__name__}.{name}", thing
                yield from public_methods(f"{module.__name__}.{name}", thing)


def public_methods(where: str, cls: type) -> Iterator[tuple[str, Any]]:
    for name, member in vars(cls).items():
        if name.startswith("_"):
            continue
        if isinstance(member, (classmethod, staticmethod)):
            yield f"{where}.{name}", member.__func__
        elif isinstance(member, property):
            yield f"{where}.{name}", member.fget
        elif inspect.isfunction(member):
            yield f"{where}.{name}", member


def documented_arguments(doc: str) -> set[str]:
    """Names in the sections Parameters, Other Parameters and Attributes."""
    names: set[str] = set()
    headers = list(SECTION.finditer(doc))
    for position, header in enumerate(headers):
        if header[1] not in ("Parameters", "Other Parameters", "Attributes"):
            continue
        end = headers[position + 1].start() if position + 1 < len(headers) else len(doc)
        for line in doc[header.end() : end].splitlines():
            if line and not line[0].isspace():
                names.update(name.strip(" *") for name in line.split(" : ")[0].split(","))
    return names


def arguments(thing: Any) -> set[str]:
    if inspect.isclass(thing):
        if issubclass(thing, Enum) or "__init__" not in vars(thing) or getattr(thing, "_is_protocol", False):
            return set()
        thing = vars(thing)["__init__"]
    names = set(inspect.signature(thing).parameters) - NOT_ARGUMENTS
    return {name for name in names if not name.startswith("_")} - explained_to_typer(thing)


def explained_to_typer(function: Callable[..., Any]) -> set[str]:
    """Arguments of a verb that carry their explanation as the text of --help."""
    try:
        hints = get_type_hints(function, include_extras=True)
    except NameError:  # names imported for type checkers only: not a verb
        return set()
    return {
        name
        for name, hint in hints.items()
        if any(getattr(extra, "help", None) for extra in getattr(hint, "__metadata__", ()))
    }


THINGS = dict(public_things())


@pytest.mark.parametrize("where", THINGS)
def test_public_thing_is_documented(where: str) -> None:
    thing = THINGS[where]
    doc = inspect.getdoc(thing) if not inspect.isclass(thing) else inspect.cleandoc(thing.__doc__ or "")
    assert doc, f"{where} has no docstring"
    missing = arguments(thing) - documented_arguments(doc)
    assert not missing, f"{where} does not document {', '.join(sorted(missing))}"


def test_an_undocumented_argument_is_noticed() -> None:
    def half_documented(elevation_rad: float, pitch_rad: float) -> None:
        """Do.

        Parameters
        ----------
        elevation_rad : float
            Elevation.
        """

    doc = inspect.getdoc(half_documented) or ""
    assert arguments(half_documented) - documented_arguments(doc) == {"pitch_rad"}


def test_arguments_documented_together_count() -> None:
    doc = "Do.\n\nParameters\n----------\nfront_V, back_V : float\n    V.\n\nReturns\n-------\nother : int\n"
    assert documented_arguments(doc) == {"front_V", "back_V"}

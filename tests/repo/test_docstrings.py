"""What docs/reference/api publishes is documented in numpydoc, argument by argument.

An argument is documented by an entry of its own, by its name in backticks in the sentences above the
entries, or by the method that is overridden. It needs no entry if its name and its type say everything:
a class of these packages, a number whose name ends in a unit, a path, a seed. Elsewhere a sentence is
enough; `ruff` requires it.
"""

import importlib
import inspect
import re
from collections.abc import Callable, Iterator
from enum import Enum
from pathlib import Path
from types import ModuleType
from typing import Any, get_type_hints

import numpy as np
import numpy.typing as npt
import pytest

Floats = npt.NDArray[np.float64]
ROOT = Path(__file__).resolve().parents[2]
PACKAGES = ("heli_host", "heli_sim", "heli_lab")
GENERATED = {"heli_host.declaration"}
PUBLISHED = re.compile(r"automodule:: (\S+)\n((?:   :\S+:.*\n)*)")
SECTION = re.compile(r"^(\w[\w ]*)\n-{3,}$", re.MULTILINE)
IN_BACKTICKS = re.compile(r"(?<!`)`(\w+)`(?!`)")
NOT_ARGUMENTS = {"self", "cls"}


def published_modules() -> Iterator[tuple[ModuleType, bool]]:
    """Modules of the reference, and whether the names they import are published too."""
    for page in sorted((ROOT / "docs" / "reference" / "api").glob("*.md")):
        for name, options in PUBLISHED.findall(page.read_text()):
            yield importlib.import_module(name), ":imported-members:" in options


def published_things() -> Iterator[tuple[str, Any]]:
    """Functions, classes and methods, each where it is defined."""
    for module, with_imported in published_modules():
        names = getattr(module, "__all__", vars(module))
        for name in names:
            thing = getattr(module, name)
            home = getattr(thing, "__module__", None) or ""
            if name.startswith("_") or home.partition(".")[0] not in PACKAGES or home in GENERATED:
                continue
            if not with_imported and home != module.__name__:
                continue
            if inspect.isfunction(thing):
                yield f"{home}:{name}", thing
            elif inspect.isclass(thing):
                for cls in (thing, *(base for base in thing.__mro__ if base.__name__[0] != "_")):
                    if cls.__module__.partition(".")[0] in PACKAGES and cls.__module__ not in GENERATED:
                        yield f"{cls.__module__}:{cls.__name__}", cls
                        yield from public_methods(f"{cls.__module__}:{cls.__name__}", cls)


def public_methods(where: str, cls: type) -> Iterator[tuple[str, Any]]:
    for name, member in vars(cls).items():
        if name.startswith("_"):
            continue
        if isinstance(member, (classmethod, staticmethod)):
            yield f"{where}.{name}", member.__func__
        elif isinstance(member, property):
            yield f"{where}.{name}", member.fget
        elif inspect.isfunction(member) and member.__qualname__.startswith(cls.__name__):
            yield f"{where}.{name}", member


def documented_arguments(doc: str) -> set[str]:
    """Names in backticks before the first section, and in Parameters, Other Parameters and Attributes."""
    headers = list(SECTION.finditer(doc))
    prose = doc[: headers[0].start()] if headers else doc
    names = set(IN_BACKTICKS.findall(prose))
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


def overridden(where: str, thing: Any) -> list[str]:
    """Docstrings of the methods that a method overrides, or of the bases of a class, nearest first."""
    if inspect.isclass(thing):
        bases = (base for base in thing.__mro__[1:] if base.__module__.partition(".")[0] in PACKAGES)
        return [inspect.cleandoc(base.__doc__ or "") for base in bases]
    module_name, _, rest = where.partition(":")
    cls_name, _, name = rest.rpartition(".")
    if not cls_name or not inspect.isfunction(thing):
        return []
    cls = getattr(importlib.import_module(module_name), cls_name)
    return [inspect.getdoc(vars(base)[name]) or "" for base in cls.__mro__[1:] if name in vars(base)]


def explained_by_type(thing: Any) -> set[str]:
    """Arguments whose type is a class of these packages, alone or several of them."""
    function = vars(thing).get("__init__") if inspect.isclass(thing) else thing
    names = {"None", *CONTAINERS}
    annotations = getattr(function, "__annotations__", {})
    matches = set()
    for argument, annotation in annotations.items():
        words = set(re.findall(r"[A-Za-z_]\w*", str(annotation)))
        if words - names and words - names <= OUR_CLASSES:
            matches.add(argument)
    return matches


def explained_by_name(thing: Any) -> set[str]:
    """Arguments that are never None and whose name and type say everything: ``stop_s: float``,
    ``path: Path``.
    """
    function = vars(thing).get("__init__") if inspect.isclass(thing) else thing
    annotations = getattr(function, "__annotations__", {})
    return {
        argument
        for argument, annotation in annotations.items()
        if SAYS_EVERYTHING.fullmatch(f"{argument}: {annotation}")
    }


CONTAINERS = {"Sequence", "list", "tuple", "Iterable", "Iterator", "Mapping", "dict", "str"}
SAYS_EVERYTHING = re.compile(
    r"\w+_(s|us|Hz|rad|deg|rad_s|rad_s2|deg_s|V|N|Nm|m|kg): float|(path|folder): (str \| )?Path|seed: int"
)
"""Name and type of arguments that need no entry."""
THINGS = dict(published_things())
OUR_CLASSES = {
    name
    for where in THINGS
    for name, thing in vars(importlib.import_module(where.partition(":")[0])).items()
    if inspect.isclass(thing) and thing.__module__.partition(".")[0] in PACKAGES
}


@pytest.mark.parametrize("where", THINGS)
def test_published_thing_is_documented(where: str) -> None:
    thing = THINGS[where]
    docstring = inspect.cleandoc(thing.__doc__ or "")
    docs = [doc for doc in (docstring, *overridden(where, thing)) if doc]
    assert docstring or (docs and not inspect.isclass(thing)), f"{where} has no docstring"
    missing = arguments(thing) - explained_by_type(thing) - explained_by_name(thing)
    for doc in docs:
        missing -= documented_arguments(doc)
    assert not missing, f"{where} does not document {', '.join(sorted(missing))}"


def test_the_reference_publishes_what_flies() -> None:
    assert {"heli_host.fly.runner:fly", "heli_lab.explain.run:diagnose"} <= set(THINGS)


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

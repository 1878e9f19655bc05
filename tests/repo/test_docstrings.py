"""Every public function, class and argument of all packages is documented, in numpydoc.

An argument is documented by an entry of its own, by its name in backticks in the sentences above the
entries, or by the method that is overridden. It needs no entry if its name and its type say everything.
That is so for a class of these packages, a number whose name ends in a unit, a path, and a seed. An entry
must say more than the name and the type: a unit, a shape, a range or a meaning.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
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
PACKAGES = ("due_emulator", "heli_host", "heli_sim", "heli_lab", "heli_benchmark")
GENERATED = {"heli_host.declaration"}
SECTION = re.compile(r"^(\w[\w ]*)\n-{3,}$", re.MULTILINE)
IN_BACKTICKS = re.compile(r"(?<!`)`(\w+)`(?!`)")
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
                yield f"{module.__name__}:{name}", thing
            elif inspect.isclass(thing):
                yield f"{module.__name__}:{name}", thing
                yield from public_methods(f"{module.__name__}:{name}", thing)


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


def entries(doc: str) -> Iterator[tuple[str, str, str]]:
    """Name, type and text of every entry of the sections on arguments."""
    headers = list(SECTION.finditer(doc))
    for position, header in enumerate(headers):
        if header[1] not in ("Parameters", "Other Parameters", "Attributes"):
            continue
        end = headers[position + 1].start() if position + 1 < len(headers) else len(doc)
        for part in re.split(r"\n(?=\S)", doc[header.end() : end].strip("\n")):
            head, _, text = part.partition("\n")
            name, _, kind = head.partition(" : ")
            yield name, kind, " ".join(text.split())


def tells_something(name: str, kind: str, text: str) -> bool:
    words = set(re.findall(r"[a-z]+|\d+", text.lower())) - SMALL_WORDS
    known = set(re.findall(r"[a-z]+|\d+", f"{name} {kind}".lower().replace("_", " ")))
    return bool(words - known) or bool(UNIT.search(text))


CONTAINERS = {"Sequence", "list", "tuple", "Iterable", "Iterator", "Mapping", "dict", "str"}
SMALL_WORDS = frozenset(
    [
        "the",
        "a",
        "an",
        "of",
        "to",
        "as",
        "its",
        "it",
        "that",
        "this",
        "is",
        "are",
        "be",
        "and",
        "or",
        "in",
        "on",
    ]
)
SAYS_EVERYTHING = re.compile(
    r"\w+_(s|us|Hz|rad|deg|rad_s|rad_s2|deg_s|V|N|Nm|m|kg): float|(path|folder): (str \| )?Path|seed: int"
)
"""Name and type of arguments that need no entry."""
UNIT = re.compile(r"\[[^]]+\]|, [A-Za-z/ 0-9%]+\.")
OUR_CLASSES = {
    name
    for module in public_modules()
    for name, thing in vars(module).items()
    if inspect.isclass(thing) and thing.__module__.partition(".")[0] in PACKAGES
}
THINGS = dict(public_things())


@pytest.mark.parametrize("where", THINGS)
def test_public_thing_is_documented(where: str) -> None:
    thing = THINGS[where]
    docstring = inspect.cleandoc(thing.__doc__ or "")
    docs = [doc for doc in (docstring, *overridden(where, thing)) if doc]
    assert docstring or (docs and not inspect.isclass(thing)), f"{where} has no docstring"
    missing = arguments(thing) - explained_by_type(thing) - explained_by_name(thing)
    for doc in docs:
        missing -= documented_arguments(doc)
    assert not missing, f"{where} does not document {', '.join(sorted(missing))}"
    empty = [name for name, kind, text in entries(docstring) if not tells_something(name, kind, text)]
    assert not empty, f"{where} says of {', '.join(empty)} only what its name and type say"


def test_an_entry_that_repeats_its_name_is_noticed() -> None:
    doc = "Do.\n\nParameters\n----------\nfit : Fit\n    The fit.\nwindow_s : float\n    Length of a run.\n"
    assert [tells_something(*entry) for entry in entries(doc)] == [False, True]


def test_an_argument_whose_name_and_type_say_everything_needs_no_entry() -> None:
    def fly(duration_s: float, front_V: float, path: Path, folder: str | Path, seed: int) -> None: ...

    assert arguments(fly) - explained_by_name(fly) == set()


def test_an_argument_whose_name_or_type_leaves_a_question_needs_an_entry() -> None:
    def fly(
        duration: float, stop_s: float | None, times_s: Floats, path: str, mode: str, seeds: int
    ) -> None: ...

    assert arguments(fly) - explained_by_name(fly) == arguments(fly)


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


def test_arguments_named_in_the_sentences_count() -> None:
    doc = "Wait `duration_s` [s] like ``sleep(other)``; see `f`.\n\nReturns\n-------\nint\n    Of `ticks`.\n"
    assert documented_arguments(doc) == {"duration_s", "f"}


def test_arguments_documented_together_count() -> None:
    doc = "Do.\n\nParameters\n----------\nfront_V, back_V : float\n    V.\n\nReturns\n-------\nother : int\n"
    assert documented_arguments(doc) == {"front_V", "back_V"}

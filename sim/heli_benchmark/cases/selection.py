"""Options that select cases by name or number, and the folder of their files."""

from __future__ import annotations

import argparse
import fnmatch
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TypeVar

from heli_benchmark.cases.clean import Case

AnyCase = TypeVar("AnyCase", bound=Case)


def add_choice(parser: argparse.ArgumentParser) -> None:
    """Add to a `parser` the options that `chosen` reads, and the option for the folder of results."""
    parser.add_argument("only", nargs="*", help="names of cases, with wildcards; default: all")
    parser.add_argument("--first", type=int, help="only the first N, a fair sample")
    parser.add_argument("--folder", type=Path, default=Path("build/blind"), help="flights and results")


def matches(name: str, patterns: Sequence[str]) -> bool:
    """Return whether a `name` matches one of the `patterns`; True if there are none."""
    return not patterns or any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns)


def chosen(cases: Iterable[AnyCase], options: argparse.Namespace) -> list[AnyCase]:
    """Return the `cases` that the parsed command line, `options`, selects, in their order."""
    return [case for case in cases if matches(case.name, options.only)][: options.first]

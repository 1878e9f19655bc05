"""Which cases a command runs, by name or the first of them, and where they are kept."""

from __future__ import annotations

import argparse
import fnmatch
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TypeVar

from tests.blind.cases import Case

AnyCase = TypeVar("AnyCase", bound=Case)


def add_choice(parser: argparse.ArgumentParser) -> None:
    """Add the options that `chosen` reads, and the folder."""
    parser.add_argument("only", nargs="*", help="names of cases, wildcards allowed; all without")
    parser.add_argument("--first", type=int, help="only so many of them, a fair sample")
    parser.add_argument("--folder", type=Path, default=Path("build/blind"), help="flights and results")


def is_wanted(name: str, patterns: Sequence[str]) -> bool:
    """Whether a name fits one of the patterns, or there are none."""
    return not patterns or any(fnmatch.fnmatchcase(name, pattern) for pattern in patterns)


def chosen(cases: Iterable[AnyCase], given: argparse.Namespace) -> list[AnyCase]:
    """Those of the cases that the options ask for, in their order."""
    return [case for case in cases if is_wanted(case.name, given.only)][: given.first]

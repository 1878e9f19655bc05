"""The cases of a campaign, their limits and results, and the key under which a result is stored."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Final

from heli_lab.errors import CampaignError

Cell = str | int | float | bool | None
"""Contents of a cell of a table."""
_NUMBER = re.compile(r"(\d+(?:\.\d+)?(?:e[+-]?\d+)?)")


def natural_order(name: str) -> list[str | float]:
    """Return a sort key for a `name` with numbers, which puts ``seed 2`` before ``seed 10``."""
    texts_and_numbers = _NUMBER.split(name)
    # Texts have even positions and numbers odd ones, so that elements at the same position can be compared.
    return [float(part) if position % 2 else part for position, part in enumerate(texts_and_numbers)]


@dataclass(frozen=True)
class Case:
    """One unit of work, which depends only on its settings and the code.

    Parameters
    ----------
    name : str
        Name for readers; it is unique in the campaign.
    work : str
        Function that runs the case, as ``package.module:function``. It takes the settings, and returns the
        row of the case, by column, and further results that JSON can hold.
    settings : Mapping of str to Any
        Argument of the function, which JSON can hold.
    """

    name: str
    work: str
    settings: Mapping[str, Any] = field(default_factory=dict)

    def key(self, code: str) -> str:
        """Return the key of the case's result: a digest of the case and of its `code`, itself a digest."""
        content = json.dumps([code, self.name, self.work, self.settings], sort_keys=True, default=str)
        return hashlib.sha256(content.encode()).hexdigest()[:24]


@dataclass(frozen=True)
class JobResult:
    """Result of a case, or the reason why it has none.

    Parameters
    ----------
    name, key : str
        Name of the case, and key under which its result is stored.
    row : Mapping of str to Cell
        Row of the case in the table: values by column name.
    detail : Any
        Everything else that the work returned. If the case failed, its traceback, if there is one.
    failure : str
        Reason why there is no result, in one line; empty if there is a result.
    cpu_s : float
        CPU time that the case took.
    seconds : float
        Time that the case took by the clock.
    where : str
        Name of the worker that ran the case.
    """

    name: str
    key: str
    row: Mapping[str, Cell] = field(default_factory=dict)
    detail: Any = None
    failure: str = ""
    cpu_s: float = 0.0
    seconds: float = 0.0
    where: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return the result as a dictionary that JSON can hold."""
        return asdict(self)

    @classmethod
    def read(cls, content: Mapping[str, Any]) -> JobResult:
        """Return the result in the `content` that `to_json` wrote; other content raises a KeyError or a
        TypeError.
        """
        return cls(**{name: content[name] for name in cls.__dataclass_fields__})


@dataclass(frozen=True)
class Limits:
    """Limits of CPU time, time and threads for one case."""

    cpu_s: float = 3600.0  # Largest CPU time [s]; counted in whole seconds, at least 1
    wait_s: float = 36000.0  # Longest time by the clock [s], for a case that waits and uses no CPU time
    threads: int = 1  # Number of threads of the libraries for linear algebra, and of the fits


_DEFAULT_LIMITS: Final = Limits()


@dataclass(frozen=True)
class Campaign:
    """A set of cases that are run together, with the limits of each case.

    Parameters
    ----------
    title : str
        Title for readers.
    cases : tuple of Case
        The cases; their names are unique.
    limits : Limits
        Limits of time and threads for each case.
    worst : str
        Column of the table whose largest values are the worst. With a minus sign in front of the name, the
        smallest values are the worst. Empty if the campaign ranks no column.
    modules : str
        Folder of modules that are not installed and that cases may use: the folder of the campaign file.
    """

    title: str
    cases: tuple[Case, ...]
    limits: Limits = _DEFAULT_LIMITS
    worst: str = ""
    modules: str = ""

    def __post_init__(self) -> None:
        if not self.cases:
            raise CampaignError("the campaign has no case", "give each list at least one value")
        seen: set[str] = set()
        for case in self.cases:
            if case.name in seen:
                raise CampaignError(f"two cases have the name {case.name}", "change a setting of one of them")
            seen.add(case.name)

    @property
    def work_functions(self) -> tuple[str, ...]:
        """Functions that run the cases."""
        return tuple(sorted({case.work for case in self.cases}))

"""A case of a campaign, the key that its result is kept under, and the answer to it."""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

Cell = str | int | float | bool | None
"""Contents of a cell of a table."""
_NUMBER = re.compile(r"(\d+(?:\.\d+)?(?:e[+-]?\d+)?)")


def natural_order(name: str) -> list[str | float]:
    """Key that sorts a `name` by the numbers in it: ``seed 2`` before ``seed 10``."""
    parts = _NUMBER.split(name)
    # Texts are at even places and numbers at odd ones, so that equal places always compare.
    return [float(part) if place % 2 else part for place, part in enumerate(parts)]


@dataclass(frozen=True)
class Case:
    """One unit of work, which depends only on its settings and the code.

    Parameters
    ----------
    name : str
        Name for readers; it is unique in the campaign.
    work : str
        Function that runs the case, as ``package.module:function``. It takes the settings. It returns the
        row of the case, by column, and further results as JSON can hold them.
    settings : Mapping of str to Any
        Arguments of the function, as JSON can hold them.
    """

    name: str
    work: str
    settings: Mapping[str, Any] = field(default_factory=dict)

    def key(self, code: str) -> str:
        """Return the key of the case's result: a digest of the case and of `code`, the digest of the code."""
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
        """Write it as JSON can hold it."""
        return asdict(self)

    @classmethod
    def read(cls, content: Mapping[str, Any]) -> JobResult:
        """Read what `to_json` wrote as `content`; a KeyError or TypeError when it is none of these."""
        return cls(**{name: content[name] for name in cls.__dataclass_fields__})

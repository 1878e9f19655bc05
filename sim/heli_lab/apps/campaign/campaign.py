"""A campaign: its cases, and the limits of each case."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from heli_lab.apps.campaign.case import Case
from heli_lab.apps.campaign.worker_process import Limits
from heli_lab.errors import CampaignError

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
    def works(self) -> tuple[str, ...]:
        """Functions that run the cases."""
        return tuple(sorted({case.work for case in self.cases}))

"""Cases outside of the project: the content of their truth files, and whether an answer is right."""

import math
import re
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from heli_benchmark.judge import RANDOM_TORQUE
from heli_benchmark.runs.case import timed_diagnosis
from heli_benchmark.task import PARTS, of_parts
from heli_benchmark.truth import ParameterValues, translated
from heli_host.data.flight import Flight
from heli_host.data.log.reader import read_flight
from heli_sim.rig import load_rig

DATA: Final = Path(__file__).resolve().parents[3] / "shared" / "data"
RIG: Final = "makki2024"
UNKNOWN: Final = "unknown"
NO_DATA: Final = "skipped: no shared data"
NEAR_STD, FAR_STD = 2.0, 3.0
"""Standard errors from which on a number is marked, and is wrong: one in 20, and one in 370 by chance."""
_NUMBER = re.compile(r"^# ([\w.]+): ([-+.\deE]+)$", re.MULTILINE)
_MIN_SHARE = 1e-3

LAW_UNTOLD: Final = frozenset({"ground_effect"})
"""Truth files say how much is gained at the table, not over which height that falls."""


@dataclass(frozen=True)
class Case:
    """Two flights and what is hidden in them."""

    # `folder`: Where they are.
    # `hidden`: Ids of what is hidden; `UNKNOWN` for a law that is on no list.
    # `sizes`: ParameterValues of the truth file by id; ``at`` is when a step comes, s.

    folder: Path
    hidden: tuple[str, ...]
    sizes: Mapping[str, float] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The folders' names."""
        return f"{self.folder.parent.name}/{self.folder.name}"

    @property
    def listed(self) -> tuple[str, ...]:
        """What is hidden and on the list."""
        return tuple(name for name in self.hidden if name != UNKNOWN)

    @property
    def verdict(self) -> str:
        """The right one."""
        if UNKNOWN in self.hidden:
            return "unexplained"
        return "cause_found" if self.hidden else "explained"

    def flights(self) -> tuple[Flight, Flight]:
        """The flight to fit and the one to hold out."""
        first, second = (read_flight(self.folder / f"{name}.csv.gz") for name in "ab")
        return first, second

    def numbers(self) -> ParameterValues:
        """True parameters of the case file, by their names in the catalogue; without rest angles, and without
        effects whose equation the file does not state.
        """
        values: dict[str, float] = {}
        for id_ in self.listed:
            if id_ not in self.sizes or id_ in LAW_UNTOLD:
                continue
            of = {"size": self.sizes[id_], "rest_rad": math.nan}
            if "at" in self.sizes:
                of["at_s"] = self.sizes["at"]
            values |= translated(id_, of, 0.0).scalars
        return {name: value for name, value in values.items() if not math.isnan(value)}


@dataclass(frozen=True)
class Judged:
    """A diagnosis of a case, compared with the truth."""

    # `case`: The case.
    # `verdict`: The verdict given; ``died`` where there is none.
    # `named`: Causes and their confidence.
    # `numbers`: Value and standard error of each number found of what is hidden, and the truth.
    # `cpu_s`: CPU time.
    # `failure`: Error that ended it.

    case: Case
    verdict: str
    named: tuple[tuple[str, float], ...]
    numbers: Mapping[str, tuple[float, float, float]]
    cpu_s: float
    failure: str = ""

    @property
    def missed(self) -> tuple[str, ...]:
        """What is hidden and was not named."""
        names = self._names()
        return tuple(name for name in self.case.listed if name not in names)

    @property
    def false_names(self) -> tuple[str, ...]:
        """Named causes that are not hidden; random torques are permitted."""
        return tuple(name for name in self._names() if name not in self.case.hidden)

    @property
    def off(self) -> dict[str, float]:
        """By how many standard errors each number is off; two engines do not agree below a thousandth."""
        return {
            name: abs(value - truth) / max(std, _MIN_SHARE * abs(truth))
            for name, (value, std, truth) in self.numbers.items()
        }

    @property
    def right(self) -> bool:
        """Whether verdict, names and numbers are."""
        names = not self.missed and not self.false_names
        return names and self.verdict == self.case.verdict and all(z <= FAR_STD for z in self.off.values())

    def line(self) -> str:
        """One row of the table, and what is wrong below it."""
        causes = ", ".join(f"{name} {sure:.2f}" for name, sure in self.named) or "no cause"
        word = "right" if self.right else "WRONG"
        lines = [
            f"{self.case.name:45s} {word}  {self.verdict:12s} {self.cpu_s:6.1f} s  {causes}",
            f"{'':45s}        hidden: {', '.join(self.case.hidden) or 'nothing'}",
        ]
        for name, (value, std, truth) in self.numbers.items():
            mark = "" if self.off[name] <= NEAR_STD else f"  {self.off[name]:.1f} standard errors off"
            lines.append(f"{'':45s}        {name} {value:.4g} +- {std:.2g}, truth {truth:.4g}{mark}")
        if self.failure:
            lines.append(f"{'':45s}        {self.failure}")
        return "\n".join(lines)

    def _names(self) -> tuple[str, ...]:
        given = [name for name, _ in self.named if not name.startswith(RANDOM_TORQUE)]
        return tuple(part for name in given for part in PARTS.get(name, (name,)))


def cases(data: Path = DATA) -> list[Case]:
    """All that are there: practice first, then field."""
    files = [path for kind in ("practice", "field") for path in sorted((data / kind).glob("*/truth.toml"))]
    return [read(path) for path in files]


def read(path: Path) -> Case:
    """Read a truth file."""
    text = path.read_text()
    sizes = {name: float(value) for name, value in _NUMBER.findall(text)}
    return Case(path.parent, tuple(tomllib.loads(text)["hidden"]), sizes)


def ask(case: Case, refits: int) -> dict[str, Any]:
    """Diagnose a case."""
    return timed_diagnosis(load_rig(RIG), case.flights(), refits)


def judged(case: Case, answer: Mapping[str, Any]) -> Judged:
    """Compare an answer with the truth."""
    result = answer["result"] or {"verdict": "died", "causes": []}
    estimates: dict[str, Any] = {}
    for cause in result["causes"]:
        for numbers in of_parts(cause["effect"], cause["parameters"]).values():
            estimates |= numbers
    numbers = {
        name: (estimates[name]["value"], estimates[name]["std"], truth)
        for name, truth in case.numbers().items()
        if name in estimates
    }
    named = tuple((cause["effect"], cause["confidence"]) for cause in result["causes"])
    return Judged(case, result["verdict"], named, numbers, answer["cpu_seconds"], answer["failure"])

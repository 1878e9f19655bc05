"""`python -m tests.running.costs`: save the CPU time of expensive tests in the last whole run.

A fresh clone, such as a build server's, orders its tests by this table. A clone that has run them uses its
pytest cache. An outdated number costs a little time and nothing else.

Run the tests on an idle machine first. If a test was above its limit, nothing is saved and the exit code is
1.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Final

from tests.running.cost import ABOVE_KEY, COSTS_KEY

TABLE: Final = Path(__file__).with_name("costs.json")
_CACHE: Final = Path(__file__).parents[2] / ".pytest_cache/v"
_MIN_S: Final = 0.5
"""CPU time from which a test is in the table. The order of cheaper tests does not matter."""


def saved_costs_s() -> dict[str, float]:
    """Return the CPU time by test from the table."""
    costs_s: dict[str, float] = json.loads(TABLE.read_text(encoding="utf-8"))
    return costs_s


def save(cache: Path, table: Path) -> list[str]:
    """Save the costs of the last run, unless a test was above its limit.

    Parameters
    ----------
    cache : Path
        Folder of the values in pytest's cache.
    table : Path
        File that is written.

    Returns
    -------
    list of str
        The tests above their limits, each with what to do.
    """
    above: dict[str, str] = json.loads((cache / ABOVE_KEY).read_text(encoding="utf-8"))
    if not above:
        all_s: dict[str, float] = json.loads((cache / COSTS_KEY).read_text(encoding="utf-8"))
        expensive_s = {name: round(cpu_s, 1) for name, cpu_s in sorted(all_s.items()) if cpu_s >= _MIN_S}
        table.write_text(json.dumps(expensive_s, indent=1) + "\n", encoding="utf-8")
    return [f"{name}: {what_to_do}" for name, what_to_do in sorted(above.items())]


if __name__ == "__main__":
    if too_expensive := save(_CACHE, TABLE):
        sys.exit("nothing saved:\n" + "\n".join(too_expensive))

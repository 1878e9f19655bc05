"""`python -m tests.running.costs`: save the CPU time of expensive tests in the last whole run.

A fresh clone, such as a build server's, orders its tests by this table. A clone that has run them uses its
pytest cache. An outdated number costs a little time and nothing else.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final

from tests.running.cost import COSTS_KEY

TABLE: Final = Path(__file__).with_name("costs.json")
_CACHE: Final = Path(__file__).parents[2] / ".pytest_cache/v" / COSTS_KEY
_MIN_S: Final = 0.5
"""CPU time from which a test is in the table. The order of cheaper tests does not matter."""


def saved_costs_s() -> dict[str, float]:
    """Return the CPU time by test from the table."""
    costs_s: dict[str, float] = json.loads(TABLE.read_text(encoding="utf-8"))
    return costs_s


if __name__ == "__main__":
    all_s = json.loads(_CACHE.read_text(encoding="utf-8"))
    expensive_s = {name: round(spent_s, 1) for name, spent_s in sorted(all_s.items()) if spent_s >= _MIN_S}
    TABLE.write_text(json.dumps(expensive_s, indent=1) + "\n", encoding="utf-8")

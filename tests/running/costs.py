"""`python -m tests.running.costs`: write down what the dear tests cost when all ran last.

A fresh clone, such as a build server's, orders its tests by this table; a clone that has run them by its own
cache. A number that is out of date costs a little time and nothing else.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Final

from tests.running.cost import COSTS_KEY

TABLE: Final = Path(__file__).with_name("costs.json")
_CACHE: Final = Path(__file__).parents[2] / ".pytest_cache/v" / COSTS_KEY
_MIN_S: Final = 0.5
"""CPU time from which on a test is written down: those below fit in anywhere."""


def written_down_s() -> dict[str, float]:
    """CPU seconds by test, as the table has them."""
    found: dict[str, float] = json.loads(TABLE.read_text(encoding="utf-8"))
    return found


if __name__ == "__main__":
    every = json.loads(_CACHE.read_text(encoding="utf-8"))
    dear = {name: round(spent_s, 1) for name, spent_s in sorted(every.items()) if spent_s >= _MIN_S}
    TABLE.write_text(json.dumps(dear, indent=1) + "\n", encoding="utf-8")

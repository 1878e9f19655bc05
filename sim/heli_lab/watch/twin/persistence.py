"""Which evidence counts for an alarm: that which persists, and does not come from single outliers."""

from __future__ import annotations

import math
from collections import deque
from typing import Final

DIAGNOSIS_DELAY_s: Final = 3.0
"""Time from the alarm to the final ranking of changes, s. Longer: the ranking is more certain but less
useful. Shorter: a step and a fade look alike."""
PERSISTENCE_BLOCKS: Final = 6
"""Number of measurements, 40 ms apart, over which evidence must persist before it counts: 0.24 s. Fewer:
rounding that a gust makes larger raises an alarm. More: sudden changes are reported that much later."""
CUT_OFF_STD: Final = 4.0
"""Size at which an innovation is cut off for the alarm (Huber), in standard deviations: 8 nats, below every
threshold. The jump of an encoder is seen uncut. Larger: a single kick of a real rig raises an alarm, and
those of nominal flights set the threshold: 38 nats at 5, 15 at 4. Smaller: large changes count little."""


class PersistentEvidence:
    """The smallest evidence of the latest `PERSISTENCE_BLOCKS` measurements [nats]; -inf before so many."""

    def __init__(self) -> None:
        self._recent_nats: deque[float] = deque(maxlen=PERSISTENCE_BLOCKS)
        self.clear()

    def clear(self) -> None:
        """Forget all measurements."""
        self._recent_nats.extend([-math.inf] * PERSISTENCE_BLOCKS)

    def add(self, nats: float) -> float:
        """Add the evidence `nats` of a measurement, and return the persistent evidence [nats]."""
        self._recent_nats.append(nats)
        return min(self._recent_nats)

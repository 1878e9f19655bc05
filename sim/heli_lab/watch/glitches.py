"""Notices that an encoder jumped and returned (an additive outlier), which is no change of the rig.

From a jump on, two filters run. The first one uses all measurements. The second one leaves out those of the
encoder that jumped. If the encoder returns to the predictions of the second filter, this filter replaces the
first one. Otherwise it is discarded, so that no evidence of a real change is lost.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Generic, Protocol, Self, TypeVar

import numpy as np
from heli_host.data.arrays import Floats
from heli_sim.model.effect import AXES

from heli_lab.watch.likelihood_ratio import LikelihoodRatio

_JUMP_STD: Final = 5.0
"""Size of a jump in standard deviations of the prediction. Chance reaches it once in some hours. Larger:
jumps by few counts count as changes. Smaller: gusts are reported as jumps."""
_MIN_JUMP_COUNTS: Final = 2.0
"""Smallest jump, counts. Smaller: an angle at the border of a count looks like a jump by one."""
MAX_BLOCKS: Final = 12
"""Greatest number of successive measurements that are left out, 40 ms apart: 0.5 s. Longer: the alarm of an
encoder that lost edges comes that much later. Shorter: jumps that return later raise an alarm."""
REFILL: Final = 0.04
"""Share of all measurements that may be left out in the long run. Larger: the twin does not follow an encoder
with a loose contact. Smaller: the second of two jumps within seconds raises an alarm."""
_DECIDABLE_STD: Final = 3.0
"""Size of the jump, in standard deviations of the prediction, below which a return cannot be noticed."""
_MAX_GROWTH: Final = 1.5
"""Growth of the jump from which the axis itself moves away. After a kick, the difference grows by 1.5 to 2
from the second to the third measurement; that of an encoder stays. Larger: the alarm after a kick comes
late."""
_ARMING_BLOCKS: Final = MAX_BLOCKS
"""Number of successive measurements near their predictions before a jump can begin: the filter has settled
then. Fewer: a filter that has not settled takes its own errors for jumps."""


class _AngleFilter(Protocol):
    """A filter of measured angles, as far as jumps concern it; see `KalmanFilter`."""

    left_out: int | None
    differences_rad: Floats
    stds_rad: Floats

    def copy(self) -> Self:
        """Return a filter with the same state."""


F = TypeVar("F", bound=_AngleFilter)


@dataclass
class WithoutEncoder(Generic[F]):
    """A filter with its likelihood ratio that does not use the measurements of a jumping encoder."""

    kalman: F  # The filter; its `left_out` is the axis of the encoder
    ratio: LikelihoodRatio  # The evidence of changes in its innovations


class GlitchWatch(Generic[F]):
    """Watches for jumps of the encoders that return. `count_rad` has shape (3,)."""

    def __init__(self, count_rad: Floats) -> None:
        self._count_rad = count_rad
        self.alternative: WithoutEncoder[F] | None = None
        # Number of measurements that may still be left out.
        self._budget = float(MAX_BLOCKS)
        # Number of successive measurements near their predictions.
        self._settled_blocks = 0
        # Differences of the jumping encoder from its predictions, in the direction of the jump [rad].
        self._differences_rad: list[float] = []
        # Direction of the jump, 1 or -1.
        self._direction = 1.0

    def copies(self, kalman: F, ratio: LikelihoodRatio) -> WithoutEncoder[F] | None:
        """Return copies of `kalman` and `ratio` before a measurement; None if no jump can begin with it."""
        self._budget = min(self._budget + REFILL, float(MAX_BLOCKS))
        if self.alternative is not None or self._settled_blocks < _ARMING_BLOCKS or self._budget < 1.0:
            return None
        return WithoutEncoder(kalman.copy(), ratio.copy())

    def begin_jump(self, kalman: F, before: WithoutEncoder[F] | None) -> None:
        """Begin a jump if the measurement that `kalman` has just used is far from its prediction."""
        # The copies `before` that measurement then become the second filter. They are None if no jump can
        # begin, because the filter has not settled, or too many measurements were left out.
        if self.alternative is not None:
            return
        size_rad = np.abs(kalman.differences_rad)
        min_jump_rad = np.maximum(_JUMP_STD * kalman.stds_rad, _MIN_JUMP_COUNTS * self._count_rad)
        axis = int(np.argmax(size_rad / min_jump_rad))
        if size_rad[axis] <= min_jump_rad[axis]:
            self._settled_blocks += 1
            return
        if before is None:
            self._settled_blocks = 0
            return
        before.kalman.left_out = axis
        self.alternative, self._differences_rad = before, []
        self._direction = math.copysign(1.0, kalman.differences_rad[axis])

    def decide_return(self) -> bool:
        """Decide about the measurement that the second filter has just left out."""
        # Returns True if the encoder has returned to the prediction of the second filter: its difference has
        # fallen by half the jump within two measurements. A slower fall is the drift of a prediction without
        # measurements: with it, a jump of 5 counts that stayed had seemed to return after 0.3 s. If the
        # encoder can no longer return, the second filter is discarded.
        assert self.alternative is not None
        kalman = self.alternative.kalman
        assert kalman.left_out is not None
        difference_rad = float(kalman.differences_rad[kalman.left_out])
        size_rad = self._direction * difference_rad
        std_rad = float(kalman.stds_rad[kalman.left_out])
        # The mean within a block may contain only a part of the jump, so the second difference counts too.
        jump_rad = max([*self._differences_rad, size_rad][:2])
        fall_in_two_blocks_rad = max(self._differences_rad[-2:], default=size_rad) - size_rad
        if size_rad < 0.5 * jump_rad and fall_in_two_blocks_rad > 0.5 * jump_rad:
            return True
        is_moving_away = size_rad > _MAX_GROWTH * jump_rad
        is_decidable = jump_rad > _DECIDABLE_STD * std_rad
        if self._budget < 1.0 or is_moving_away or not is_decidable:
            self.alternative, self._settled_blocks = None, 0
            return False
        self._budget -= 1.0
        self._differences_rad.append(size_rad)
        return False

    def end_jump(self, t_s: float, block_s: float) -> tuple[WithoutEncoder[F], str]:
        """End a jump that returned at `t_s` [s]; return the second filter, and what happened."""
        # Measurements are `block_s` [s] apart.
        alternative = self.alternative
        assert alternative is not None and alternative.kalman.left_out is not None
        axis = alternative.kalman.left_out
        length_s = len(self._differences_rad) * block_s
        counts = max(self._differences_rad) / self._count_rad[axis]
        alternative.kalman.left_out = self.alternative = None
        return alternative, (
            f"the {AXES[axis]} encoder jumped by {counts:.0f} counts at {t_s - length_s:.1f} s and returned "
            f"within {length_s:.2g} s; this is no change of the rig"
        )

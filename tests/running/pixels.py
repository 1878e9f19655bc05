"""Measures of a picture, for tests of figures."""

from pathlib import Path
from typing import Final

import matplotlib.image as mpimg
import numpy as np

_COLOURED: Final = 0.15
"""Difference of the largest and the smallest of red, green and blue; text, axes and grids have none."""


def coloured_share(picture: Path) -> float:
    """Return the share of pixels that are neither white, grey nor black: curves, bars and areas."""
    colours = mpimg.imread(picture)[..., :3]
    return float(np.mean(np.ptp(colours, axis=-1) > _COLOURED))

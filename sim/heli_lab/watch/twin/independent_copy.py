"""Copies of filters that develop independently."""

from __future__ import annotations

from copy import copy
from typing import TypeVar

import numpy as np

T = TypeVar("T")


def independent_copy(original: T) -> T:
    """Return a copy with separate arrays. Other attributes are shared; no update changes them in place."""
    other = copy(original)
    for name, value in vars(original).items():
        if isinstance(value, np.ndarray):
            setattr(other, name, value.copy())
    return other

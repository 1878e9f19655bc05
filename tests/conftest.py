"""Shared by all tests: helpers that lie beside the tests of a room can be imported by their name."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent / "link"))

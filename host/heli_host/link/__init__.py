"""The link: bytes to frames to ticks, and the session on top of them."""

from __future__ import annotations

"""Talks to a 3-DOF helicopter board, real or simulated, over one link."""

from __future__ import annotations

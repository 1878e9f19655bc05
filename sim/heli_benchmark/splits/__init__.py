"""Splits of the published benchmark: drawn, flown by MuJoCo, and written as folders."""

from heli_benchmark.splits.make import make_split
from heli_benchmark.splits.seal import Seal, read_seal

__all__ = ["Seal", "make_split", "read_seal"]

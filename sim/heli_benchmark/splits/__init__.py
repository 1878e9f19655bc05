"""Splits of the published benchmark: drawn, flown by MuJoCo, and written as folders."""

from heli_benchmark.splits.make import make_split

__all__ = ["make_split"]

"""Runs of methods on a split, each case in a process with limits."""

from heli_benchmark.entries.case_process import RunLimits
from heli_benchmark.entries.run import read_run, run_method

__all__ = ["RunLimits", "read_run", "run_method"]

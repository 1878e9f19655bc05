"""The process of a case or of a training, from outside: its start, its limits, and its end."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from heli_benchmark.entries.method import MethodAddress
from heli_benchmark.task.json_file import read_json, write_json

WALL_FACTOR: Final = 30.0
"""Elapsed time per CPU time from which a process counts as hanging without work. At 4, a case on a computer
with 25 busy processes was stopped before its CPU limit."""


@dataclass(frozen=True)
class RunLimits:
    """Limits of the process of a case."""

    cpu_s: int = 300  # CPU time
    memory_MB: int = 6000  # Address space


def run_case(
    method: MethodAddress, case: str, resources: Path | None, limits: RunLimits, file: Path
) -> dict[str, Any]:
    """Run a method on a case in a process, and return its result."""
    resources_text = "-" if resources is None else str(resources.resolve())
    command = [
        sys.executable,
        "-m",
        "heli_benchmark.entries.worker",
        method.text,
        case,
        str(file.resolve()),
        resources_text,
    ]
    command += [str(limits.cpu_s), str(limits.memory_MB)]
    # Threads that wait for each other cost CPU time, and sums in another order change the last digits.
    threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    environment = {**os.environ, **threads, "PYTHONHASHSEED": "0"}
    failure = ""
    try:
        process = subprocess.run(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=WALL_FACTOR * limits.cpu_s,
            check=False,
        )
        if process.returncode:
            failure = f"the process ended with code {process.returncode}; its limits are {limits}"
    except subprocess.TimeoutExpired:
        failure = f"the process took more than {WALL_FACTOR * limits.cpu_s:.0f} s"
    if failure:
        write_json(file, {"answer": None, "failure": failure, "cpu_s": None, "peak_MB": None})
    return read_json(file, "run the method again")

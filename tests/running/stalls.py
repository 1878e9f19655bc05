"""``python -m tests.running.stalls SEED COMMAND...``: run a command while its processes stall at random.

It stops one process below the command after the other for 0.1 s to 0.6 s, as a very busy machine does, but at
little cost: ``python -m tests.running.stalls 1 .venv/bin/python -m pytest -n 2 tests/sil``. A test that fails
depends on the load of the machine. Linux only.
"""

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final

RUNS_S: Final = (0.05, 0.5)
"""Range of the time between two stalls."""
STALLS_S: Final = (0.1, 0.6)
"""Range of the time of a stall. Among twenty others on two cores, a process waits a tenth of a second; after
more than 0.6 s, a simulated board in real time rightly misses its host."""


def descendants(pid: int) -> list[int]:
    """Return the processes below a process."""
    pids: list[int] = []
    with contextlib.suppress(OSError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            for child in map(int, (task / "children").read_text().split()):
                pids += [child, *descendants(child)]
    return pids


def run(seed: int, command: Sequence[str]) -> tuple[int, int]:
    """Run a command with stalls; return its exit status and the number of stalls."""
    chance, stalls = random.Random(seed), 0
    program = subprocess.Popen(command)
    while program.poll() is None:
        time.sleep(chance.uniform(*RUNS_S))
        # A command without children is stopped itself.
        pid = chance.choice(descendants(program.pid) or [program.pid])
        with contextlib.suppress(OSError):
            os.kill(pid, signal.SIGSTOP)
            stalls += 1
            try:
                time.sleep(chance.uniform(*STALLS_S))
            finally:
                os.kill(pid, signal.SIGCONT)
    return program.returncode, stalls


if __name__ == "__main__":
    status, count = run(int(sys.argv[1]), sys.argv[2:])
    print(f"{count} stalls, exit status {status}")
    sys.exit(status)

"""``python -m tests.bench.page_tabs HOST PORT TOKEN TABS``: tabs of a page in a process of their own.

It obeys each line of standard input. The answer is one line: ``press`` stops by the socket of the first
tab, and gives the time before that [s, monotonic]; ``gaps`` gives the number of ticks that the tabs missed.
"""

from __future__ import annotations

import random
import sys
import time

import numpy as np
from heli_host.ui.page.serve import Address

from tests.page.page_server import SocketPage


def missing(page: SocketPage) -> int:
    """Count the ticks that a tab did not get, of those since the first frame, which may be thinned."""
    tick = np.concatenate([batch.tick for batch in list(page.rows)[1:]])
    return int((np.diff(tick) - 1).sum())


def main(host: str, port: str, token: str, tabs: str) -> None:
    """Open tabs and do what is asked, until the input ends."""
    dice = random.Random(1)
    pages = [SocketPage(Address(host, int(port), token)) for _ in range(int(tabs))]
    print("ready", flush=True)
    for line in sys.stdin:
        if line.strip() == "press":
            # Anywhere between two frames, and between two readings of the link.
            time.sleep(dice.uniform(0.0, 0.1))
            pressed_s = time.monotonic()
            pages[0].stop()
            print(pressed_s, flush=True)
        else:
            print(sum(missing(page) for page in pages), flush=True)
    for page in pages:
        page.close()


if __name__ == "__main__":
    main(*sys.argv[1:])

"""All random attacks behind one command: faulty links, damaged logs, hostile clients, hostile laws.

``python -m tests.stress attack --seed 1 --count 50`` runs each of them with that seed and prints one table. A
seed is always the same attack; those over a port or a socket also depend on the computer's timing.
"""

import random
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Final

from heli_host.ui.page.serve import Address
from websockets.exceptions import WebSocketException

from tests.law.hostile import HOSTILE, RIGS, tries
from tests.link.fuzz_host import fuzz_host
from tests.log.fuzz_log import fuzz_log
from tests.page.hostile_requests import hostile_http, hostile_request
from tests.page.page_server import SocketPage, log_lines, page_of_a_simulated_board, traces
from tests.sil.faulty_flights import case, flown, mistakes_of
from tests.stress.serial_stories import live, preload, story

_OF_A_SEED: Final = 100_000
"""Numbers of flights and stories of one seed: no two seeds share any."""


def numbers(seed: int, count: int) -> range:
    """Return the numbers of the flights or stories that belong to a seed."""
    return range(seed * _OF_A_SEED, seed * _OF_A_SEED + count)


def faulty_links(seed: int, count: int) -> Iterator[str]:
    """Fly over links with noise, stalls and unplugging; complain about samples, reasons and motors."""
    for number in numbers(seed, count):
        faulty_flight = case(number)
        yield from (f"{faulty_flight}: {complaint}" for complaint in mistakes_of(flown(faulty_flight)))


def serial_trouble(seed: int, count: int) -> Iterator[str]:
    """Live through stories on a pseudo-terminal."""
    preload()
    for number in numbers(seed, count):
        with tempfile.TemporaryDirectory(prefix="heli-story-") as folder:
            yield from (f"{story(number)}: {text}" for text in live(story(number), Path(folder)).complaints)


def odd_frames(seed: int, count: int) -> Iterator[str]:
    """Send frames that no board would send to the host."""
    _, broken = fuzz_host(seed, count)
    yield from (f"{often} times {what}" for what, often in broken.most_common())


def damaged_logs(seed: int, count: int) -> Iterator[str]:
    """Read damaged logs."""
    yield from (f"{often} times {what}" for what, often in fuzz_log(seed, count).most_common())


def hostile_laws(seed: int, count: int) -> Iterator[str]:
    """Fly laws that turn hostile at any setpoint; complain where the arm ends up."""
    chance = random.Random(seed)
    for number in numbers(seed, count):
        tried = tries(chance.choice(list(HOSTILE)), chance.choice(list(RIGS)), number)
        if problem := tried.problem():
            yield f"{tried.which}: {problem}"


def hostile_clients(seed: int, count: int) -> Iterator[str]:
    """Send odd requests to a page's server; complain about traces, missing answers and statuses."""
    with (
        tempfile.TemporaryDirectory(prefix="heli-attack-") as folder,
        page_of_a_simulated_board(Path(folder)) as served,
        log_lines() as lines,
    ):
        yield from attack_page(served.address, seed, count)
        yield from traces(lines)
        yield from (line for line in lines if " failed: " in line or "cannot be" in line)


def attack_page(address: Address, seed: int, count: int) -> Iterator[str]:
    """Send odd requests, half of them by HTTP, and see that the page still gets answers and statuses."""
    chance = random.Random(seed)
    with SocketPage(address, "attacker") as page:
        for _ in range(count):
            if chance.random() < 0.5:
                if trouble := hostile_http(chance, address):
                    yield trouble
                continue
            request = hostile_request(chance, harmless=True)
            name = request.pop("do")
            unnumbered = page.refused_without_number
            try:
                number = page.send(name, **request)
            except UnicodeEncodeError:
                continue
            except WebSocketException as error:
                yield f"{name} {request!r:.200}: the server has closed the socket: {error}"
                return
            if not page.until_or(partial(_answered, page, number, unnumbered), 20.0):
                yield f"{name} {request!r:.200} is not answered"
                return
        before = page.statuses
        if not page.until_or(lambda: page.statuses >= before + 2, 10.0):
            yield "no status comes any more"


def _answered(page: SocketPage, number: int, unnumbered: int) -> bool:
    # A message that is too long is refused without its number.
    if page.refused_without_number > unnumbered:
        return True
    return any(words.get("answer") == number for words in list(page.words)[-50:])


@dataclass(frozen=True)
class Attack:
    """One kind of attack."""

    what: str
    run: Callable[[int, int], Iterator[str]]
    weight: int = 1


ATTACKS: Final = {
    "links": Attack("flights over faulty links", faulty_links),
    "serial": Attack("stories of serial trouble", serial_trouble),
    "frames": Attack("frames that no board sends", odd_frames, 2000),
    "logs": Attack("damaged logs", damaged_logs, 20),
    "clients": Attack("requests of hostile clients", hostile_clients, 20),
    "laws": Attack("flights of hostile laws", hostile_laws),
}


def attack(
    seed: int, count: int, names: list[str] | None = None, say: Callable[[str], None] = print
) -> tuple[list[str], int]:
    """Run attacks; return a table with one line per kind, and how many complaints there were."""
    lines = [f"| attack (seed {seed}) | tried | complaints | seconds |", "|---|---|---|---|"]
    total = 0
    for name, attack in ATTACKS.items():
        if names and name not in names:
            continue
        begin_s, complaints = time.monotonic(), 0
        for complaint in attack.run(seed, count * attack.weight):
            complaints += 1
            say(f"{name}: {complaint}")
        total += complaints
        spent_s = time.monotonic() - begin_s
        lines.append(f"| {attack.what} | {count * attack.weight} | {complaints} | {spent_s:.0f} |")
    return lines, total

"""Guess two hundred distorted flights: ``python -m tests.guess``."""

import argparse
import collections
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

from heli_host.data.tables import read_table
from heli_lab.setup.guess import guess_by_rigs
from heli_sim.rig import load_rig

from tests.guess.distort import FileVerdict, draw_distortion, judge_file, write
from tests.guess.exports import FORMS, corrections
from tests.guess.flights import SIMULATED, measured, measured_flight, simulated

COUNT = 200


def main(arguments: Sequence[str] | None = None) -> int:
    """Distort, guess, print; 1 when one guess is silently wrong."""
    parser = argparse.ArgumentParser(prog="python -m tests.guess", description=__doc__)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--first", type=int, default=0, help="first seed")
    parser.add_argument(
        "--measured", action="store_true", help="the measured flights of the shared data instead"
    )
    parser.add_argument(
        "--exports", action="store_true", help="the measured flights of the shared data in further forms"
    )
    parser.add_argument("--rig", help="with --exports: use this rig file instead of the best shipped one")
    given = parser.parse_args(arguments)
    if given.exports:
        return _exports(given.first, given.rig)
    files = measured() if given.measured else []
    if given.measured and not files:
        print("skipped: no shared data")
        return 0
    tally: collections.Counter[str] = collections.Counter()
    for seed in range(given.first, given.first + given.count):
        path = files[seed % len(files)] if files else None
        guess_result = judge_seed(seed, path)
        tally[guess_result.verdict] += 1
        print(
            f"{seed:4d} {guess_result.verdict:15s} {draw_distortion(seed).text()} | {guess_result.reason}",
            flush=True,
        )
    print()
    for verdict, count in tally.most_common():
        print(f"{count:4d} {verdict}")
    return 1 if tally["SILENTLY WRONG"] else 0


def _exports(first: int, rig: str | None) -> int:
    """Write a measured flight in every further form; 1 where a guess needs more than two corrections."""
    files = measured()
    if not files:
        print("skipped: no shared data")
        return 0
    most = 0
    for number, (name, form) in enumerate(FORMS.items(), first):
        path = files[number % len(files)]
        flight, _ = measured_flight(path)
        with tempfile.TemporaryDirectory() as folder:
            table = read_table(form(flight, Path(folder)))
            fitting = guess_by_rigs([table], load_rig(rig) if rig else None)
            (guess_result,) = fitting.guesses
            wrong = corrections(table, guess_result, flight)
        most = max(most, len(wrong))
        ambiguities = "; ".join(ambiguity.subject for ambiguity in guess_result.ambiguities)
        print(
            f"{len(wrong)} {fitting.rig.name:15s} {name:28s} {', '.join(wrong)} | {ambiguities}", flush=True
        )
    return 1 if most > 2 else 0


def judge_seed(seed: int, path: Path | None = None) -> FileVerdict:
    """Distort a flight from a `seed` and judge the guess: the measured one at `path`, or a simulated one."""
    flight, rig = measured_flight(path) if path else simulated(seed % SIMULATED)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "flight.csv"
        how = draw_distortion(seed)
        truth = write(flight, rig, how, file, seed)
        return judge_file(file, truth, how, rig)


if __name__ == "__main__":
    sys.exit(main())

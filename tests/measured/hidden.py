"""Known effects hidden in the measured flights: ``python -m tests.measured.hidden``.

Six effects of two sizes are hidden in each of four pairs, both flights alike, and diagnosed. A step comes in
the middle of the part that flies. Results are kept in a file, so that an interrupted run continues.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from heli_benchmark.real.hide import HIDDEN_EFFECTS, KnownEffect, hide
from heli_benchmark.real.score import HiddenResult, score
from heli_host.log.flight_file import read_flight
from heli_lab.diagnose import diagnose, to_json
from heli_lab.identify import Record, prepare
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig

from tests.measured.pairs import MEASURED, PAIRS, RIG, FROM_s, LANDS_s

KEPT: Final = Path("build/hidden-in-measured.jsonl")


def hidden_pair(pair: str, effect: KnownEffect | None) -> tuple[Record, Record]:
    """Read a pair and hide an effect in both flights; None reads them unchanged."""
    rig, records = load_rig(RIG), []
    for name in PAIRS[pair]:
        flight, stop_s = read_flight(MEASURED / f"{name}.csv.gz"), LANDS_s.get(name)
        if effect is not None:
            count_rad = prepare(flight, rig, name, start_s=FROM_s, stop_s=stop_s).count_rad
            ends_s = stop_s or float(flight.t_s[-1])
            flight = hide(flight, effect, 0.5 * (FROM_s + ends_s), count_rad)
        records.append(prepare(flight, rig, name, start_s=FROM_s, stop_s=stop_s))
    return records[0], records[1]


def diagnosed(pair: str, effect: KnownEffect | None) -> dict[str, Any]:
    """Diagnose a pair, and keep only what the score needs."""
    train, held_out = hidden_pair(pair, effect)
    result = to_json(diagnose(MultibodyModel(), load_rig(RIG), [train], [held_out], labels=list(PAIRS[pair])))
    return {key: result[key] for key in ("verdict", "causes", "rig", "undetectable")}


def scored(
    pair: str, effect: KnownEffect, result: Mapping[str, Any], reference: Mapping[str, Any]
) -> HiddenResult:
    """Judge the diagnosis of a pair."""
    train, _ = hidden_pair(pair, effect)
    return score(effect, result, reference, train.voltages_V, train.t_s, load_rig(RIG))


def rows(
    pairs: Sequence[str], effects: Sequence[KnownEffect], kept: Path
) -> Iterator[tuple[str, HiddenResult]]:
    """Diagnose what is not in the file yet, and judge everything.

    Parameters
    ----------
    pairs : sequence of str
        Keys of `PAIRS`.
    kept : Path
        File of results, a line each.
    """
    done: dict[str, dict[str, Any]] = {}
    if kept.exists():
        for line in kept.read_text().splitlines():
            row = json.loads(line)
            done[row["key"]] = row["result"]
    kept.parent.mkdir(parents=True, exist_ok=True)

    def result(pair: str, effect: KnownEffect | None) -> dict[str, Any]:
        key = f"{pair} {effect.id} {effect.size:.4g}" if effect else f"{pair} nothing"
        if key not in done:
            done[key] = diagnosed(pair, effect)
            with kept.open("a") as file:
                file.write(json.dumps({"key": key, "result": done[key]}) + "\n")
        return done[key]

    for pair in pairs:
        reference = result(pair, None)
        for effect in effects:
            yield pair, scored(pair, effect, result(pair, effect), reference)


def main(arguments: Sequence[str] | None = None) -> int:
    """Hide, diagnose and print a table.

    Parameters
    ----------
    arguments : sequence of str, optional
        Instead of the command line's.

    Returns
    -------
    int
        Exit status: 2 without the flights.
    """
    parser = argparse.ArgumentParser(prog="python -m tests.measured.hidden", description=__doc__)
    parser.add_argument("pairs", nargs="*", help=f"some of {', '.join(PAIRS)}; all without")
    parser.add_argument("--effect", action="append", help="only this effect; may be given again")
    parser.add_argument("--kept", type=Path, default=KEPT, help="file of results")
    given = parser.parse_args(arguments)
    if not MEASURED.exists():
        print("skipped: no shared data")
        return 2
    effects = [effect for effect in HIDDEN_EFFECTS if not given.effect or effect.id in given.effect]
    results = []
    for pair, row in rows(given.pairs or list(PAIRS), effects, given.kept):
        results.append(row)
        print(_line(pair, row), flush=True)
    print(*summary(results), sep="\n")
    return 0


def _line(pair: str, row: HiddenResult) -> str:
    state = "named" if row.named else "undetectable" if row.undetectable else "MISSED"
    new = ", ".join(f"{name} {confidence:.2f}" for name, confidence in row.new_names)
    return (
        f"{pair:13} {row.effect.id:28} {row.effect.size:7.4g}  {state:12} {row.confidence:5.2f} "
        f"{row.size:9.4g} ± {row.std:.2g}, truth {row.truth:.4g}{'; new: ' + new if new else ''}"
    )


def summary(results: Sequence[HiddenResult]) -> list[str]:
    """Count what was named, right in size, and named without being hidden.

    Parameters
    ----------
    results : sequence of HiddenResult
        One for each hidden effect.
    """
    detectable = [row for row in results if row.named or not row.undetectable]
    named = [row for row in detectable if row.named]
    sized = [row for row in named if row.std > 0.0]
    quiet = [row for row in results if not row.new_names]
    bins = [(0.0, 0.5), (0.5, 0.8), (0.8, 1.01)]
    answers = [(row.confidence, True) for row in named]
    answers += [(sure, False) for row in results for _, sure in row.new_names]
    lines = [
        f"detectable and named: {len(named)} of {len(detectable)}",
        f"declared undetectable: {len(results) - len(detectable)} of {len(results)}",
        f"sizes within two standard errors: {sum(row.size_is_right for row in sized)} of {len(sized)}",
        f"no new name: {len(quiet)} of {len(results)}",
    ]
    for low, high in bins:
        inside = [right for sure, right in answers if low <= sure < high]
        lines.append(f"confidence {low:g} to {min(high, 1.0):g}: {sum(inside)} of {len(inside)} right")
    return lines


if __name__ == "__main__":
    sys.exit(main())

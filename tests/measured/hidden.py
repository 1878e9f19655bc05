"""Known effects hidden in the measured flights: ``python -m tests.measured.hidden``.

Six effects of two sizes are hidden in each of four pairs, both flights alike, and diagnosed. A step comes in
the middle of the part that flies. Diagnoses are kept for as long as the code that makes them is the same, so
an interrupted run continues.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Final

import heli_benchmark.real
from heli_benchmark.real import HIDDEN_EFFECTS, HIDERS, HiddenResult, KnownEffect, hide, score
from heli_host.data.flight import Flight
from heli_lab.diagnose import diagnose, to_json
from heli_lab.fit.records import Record, encoder_counts
from heli_sim.model import MultibodyModel
from heli_sim.rig import load_rig

from tests.field.cases import NO_DATA
from tests.measured import pairs
from tests.measured.pairs import MEASURED, PAIRS, RIG, FROM_s, LANDS_s, add_pairs, flights
from tests.running.kept import KEPT

MADE_BY: Final = tuple(map(Path, (__file__, pairs.__file__, heli_benchmark.real.__file__)))


def hidden_pair(pair: str, effect: KnownEffect | None) -> tuple[Record, Record]:
    """Read a pair and hide an effect in both flights; None reads them unchanged."""
    if effect is None:
        return flights(pair)
    rig = load_rig(RIG)

    def change(flight: Flight, name: str) -> Flight:
        middle_s = 0.5 * (FROM_s + LANDS_s.get(name, float(flight.t_s[-1])))
        counts_rad, _ = encoder_counts(flight, rig)
        return hide(flight, effect, middle_s, counts_rad)

    return flights(pair, change=change)


def diagnosed(pair: str, effect: KnownEffect | None, records: tuple[Record, Record]) -> dict[str, Any]:
    """Diagnose `records`, a pair with an effect; what the score needs of it is kept for the next run."""

    def diagnosis() -> dict[str, Any]:
        train, held_out = records
        labels = list(PAIRS[pair])
        result = to_json(diagnose(MultibodyModel(), load_rig(RIG), [train], [held_out], labels=labels))
        return {key: result[key] for key in ("verdict", "causes", "rig", "undetectable", "ranking")}

    what = f"{effect.id} {effect.size:.4g}" if effect else "nothing"
    return KEPT(f"hidden in {pair}: {what}", diagnosis, made_by=MADE_BY)


def rows(names: Sequence[str], effects: Sequence[KnownEffect]) -> Iterator[tuple[str, HiddenResult]]:
    """Diagnose and judge each effect in each pair."""
    rig = load_rig(RIG)
    for pair in names:
        reference = diagnosed(pair, None, hidden_pair(pair, effect=None))
        for effect in effects:
            records = hidden_pair(pair, effect)
            result = diagnosed(pair, effect, records)
            train, _ = records
            yield pair, score(effect, result, reference, train.voltages_V, train.t_s, rig)


def main(arguments: Sequence[str] | None = None) -> int:
    """Hide, diagnose and print a table."""
    parser = argparse.ArgumentParser(prog="python -m tests.measured.hidden", description=__doc__)
    add_pairs(parser)
    ids = tuple(HIDERS)
    parser.add_argument(
        "--effect", action="append", choices=ids, metavar="EFFECT", help=f"only this one of {', '.join(ids)}"
    )
    given = parser.parse_args(arguments)
    if not MEASURED.exists():
        print(NO_DATA)
        return 2
    effects = [effect for effect in HIDDEN_EFFECTS if not given.effect or effect.id in given.effect]
    results = []
    for pair, row in rows(given.pairs or list(PAIRS), effects):
        results.append(row)
        print(_line(pair, row), flush=True)
    print(*summary(results), sep="\n")
    return 0


def _line(pair: str, row: HiddenResult) -> str:
    state = "named" if row.named else "undetectable" if row.undetectable else "MISSED"
    new = ", ".join(
        f"{name} {confidence:.2f}{' (supported before)' if name in row.supported_names else ''}"
        for name, confidence in row.new_names
    )
    wrong = ""
    if row.std > 0.0 and not row.size_is_right:
        wrong = f", WRONG by {abs(row.size - row.truth) / row.std:.1f} standard errors"
    return (
        f"{pair:13} {row.effect.id:28} {row.effect.size:7.4g}  {state:12} {row.confidence:5.2f} "
        f"{row.size:9.4g} ± {row.std:.2g}, truth {row.truth:.4g}{wrong}"
        f"{'; new: ' + new if new else ''}"
    )


def summary(results: Sequence[HiddenResult]) -> list[str]:
    """Count what was named, right in size, and named without being hidden."""
    detectable = [row for row in results if row.named or not row.undetectable]
    named = [row for row in detectable if row.named]
    sized = [row for row in named if row.std > 0.0]
    quiet = [row for row in results if not row.new_names]
    total = len(results)
    caused = [row for row in results if len(row.new_names) > len(row.supported_names)]
    bins = [(0.0, 0.5), (0.5, 0.8), (0.8, 1.01)]
    answers = [(row.confidence, True) for row in named]
    answers += [(sure, False) for row in results for _, sure in row.new_names]
    lines = [
        f"detectable and named: {len(named)} of {len(detectable)}",
        f"declared undetectable: {total - len(detectable)} of {total}",
        f"sizes within two standard errors: {sum(row.size_is_right for row in sized)} of {len(sized)}",
        f"no new name: {len(quiet)} of {total}",
        f"no new name that the unchanged flights do not support: {total - len(caused)} of {total}",
    ]
    for low, high in bins:
        inside = [right for sure, right in answers if low <= sure < high]
        lines.append(f"confidence {low:g} to {min(high, 1.0):g}: {sum(inside)} of {len(inside)} right")
    return lines


if __name__ == "__main__":
    sys.exit(main())

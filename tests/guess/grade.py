"""Grade guesses of raw files of other repositories: ``python -m tests.guess.grade``."""

import argparse
import re
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from heli_host.data.tables import Profile, read_table
from heli_host.errors import HeliError
from heli_lab.setup.guess import Guess, guess_by_rigs, merge_tables

from tests.guess.exports import corrections
from tests.guess.foreign import ForeignFile, write

DEVELOPMENT_SEEDS: Final = range(20)
JUDGING_SEEDS: Final = range(3000, 3020)
_MAX_DELAY_s: Final = 0.06
"""Delays as a flight shows them scatter by this much."""
_REFUSED: Final = 9
"""Corrections of a file that is not guessed at all: every entry."""


@dataclass(frozen=True)
class Grade:
    """Grade of one guess."""

    # `wrong`: Entries of the profile to correct.
    # `silent`: Those of them whose right value no doubt names.
    # `sure`: Whether the guess had no doubt.
    # `doubts`: All doubts.

    wrong: tuple[str, ...]
    silent: tuple[str, ...]
    sure: bool
    doubts: tuple[str, ...]

    @property
    def corrections(self) -> int:
        """Number of corrections; the file's maximum if it was refused."""
        return _REFUSED if self.wrong[:1] == ("refused",) else len(self.wrong)


def grade(file: ForeignFile) -> Grade:
    """Guess a file as `heli-host import` does, and compare with its true profile."""
    try:
        tables = [read_table(path) for path in file.paths]
        table = merge_tables(tables) if len(tables) > 1 else tables[0]
        (guess,) = guess_by_rigs([table], file.rig).guesses
        wrong = _wrong_entries(file, table, guess)
    except HeliError as error:
        return Grade(("refused",), ("refused",), False, (str(error),))
    doubts = tuple(ambiguity.sentence() for ambiguity in guess.ambiguities)
    silent = tuple(entry for entry in wrong if not _named(entry, file.profile, guess))
    return Grade(wrong, silent, guess.sure, doubts)


def _wrong_entries(file: ForeignFile, table: object, guess: Guess) -> tuple[str, ...]:
    # Delays are compared as such; without them the flights can be compared row by row.
    guessed = replace(guess, profile=_with_delays(guess.profile, file.profile))
    mistakes = list(corrections(table, guessed, file.truth))  # type: ignore[arg-type]
    wrong_unit: list[str] = []
    in_true_units = _with_voltage_units(guessed.profile, file.profile)
    if in_true_units is not None and any(entry.endswith(".column") for entry in mistakes):
        # Commands in a wrong unit are clipped elsewhere, and then do not even resemble the voltages.
        guessed = replace(guessed, profile=in_true_units)
        mistakes = list(corrections(table, guessed, file.truth))  # type: ignore[arg-type]
        wrong_unit = ["voltages.unit"]
    supply_V = next(iter(file.profile.voltages.values())).supply_V
    as_logged = mistakes
    for smallest_V in (-supply_V, 0.0):
        clipped = replace(guessed.profile, clip_V=(smallest_V, supply_V))
        others = list(corrections(table, replace(guessed, profile=clipped), file.truth))  # type: ignore[arg-type]
        if len(others) < len(as_logged) and (mistakes is as_logged or len(others) + 1 < len(mistakes)):
            mistakes = [*others, f"voltages.clip_V {smallest_V:g} to {supply_V:g}"]
    mistakes += wrong_unit
    units = [entry for entry in mistakes if ".unit" in entry and entry.split(".")[0] in file.profile.voltages]
    if len(units) == len(file.profile.voltages) and len({unit.split(".")[1] for unit in units}) == 1:
        # One entry gives the unit of both voltages.
        mistakes = [entry for entry in mistakes if entry not in units] + [
            f"voltages.{units[0].split('.', 1)[1]}"
        ]
    if guess.profile.time_unit != file.profile.time_unit:
        mistakes.append("time.unit")
    for name, mine, true in _delays(guess.profile, file.profile):
        if abs(mine - true) > _MAX_DELAY_s:
            mistakes.append(f"{name}.delay_s {mine:.2f}")
    return tuple(mistakes)


def _with_delays(profile: Profile, true: Profile) -> Profile:
    angles = {axis: replace(a, delay_s=true.angles[axis].delay_s) for axis, a in profile.angles.items()}
    late_s = next(iter(true.voltages.values())).delay_s
    voltages = {name: replace(v, delay_s=late_s) for name, v in profile.voltages.items()}
    return replace(profile, angles=angles, voltages=voltages)


def _with_voltage_units(profile: Profile, true: Profile) -> Profile | None:
    """The profile with the true units of the voltages; None if it has them, or other columns."""
    pairs = [(voltage, true.voltages.get(role)) for role, voltage in profile.voltages.items()]
    if any(right is None or voltage.column != right.column for voltage, right in pairs):
        return None
    names = ("unit", "full", "factor")
    voltages = {
        role: replace(voltage, **{name: getattr(true.voltages[role], name) for name in names})
        for role, voltage in profile.voltages.items()
    }
    if voltages == dict(profile.voltages):
        return None
    return replace(profile, voltages=voltages)


def _delays(profile: Profile, true: Profile) -> list[tuple[str, float, float]]:
    both = [(axis, profile.angles[axis].delay_s, true.angles[axis].delay_s) for axis in profile.angles]
    first = [next(iter(p.voltages.values())).delay_s for p in (profile, true)]
    return [*both, ("voltages", first[0], first[1])]


def _named(entry: str, true: Profile, guess: Guess) -> bool:
    """Whether one doubt names the right value of a wrong entry."""
    return any(
        _names(entry, true, f"{doubt.subject}; {doubt.chosen}; {doubt.alternative}; {doubt.reason}")
        for doubt in guess.ambiguities
    )


def _names(entry: str, true: Profile, doubt: str) -> bool:
    if entry == "mirrored":
        return "set mirrored =" in doubt
    if entry.startswith("voltages.clip_V"):
        smallest, _, largest = entry.removeprefix("voltages.clip_V ").partition(" to ")
        return "clipped to 0 V" in doubt if smallest == "0" else f"clipped to {largest} V" in doubt
    if entry == "time.unit":
        return f"in {true.time_unit}" in doubt
    part, _, what = entry.partition(".")
    holder = true.angles.get(part) or true.voltages.get(part) or next(iter(true.voltages.values()))
    numbers = [float(number) for number in re.findall(r"-?\d+\.?\d*", doubt)]
    if what == "column":
        return re.search(rf"(?<![\w[\]]){re.escape(holder.column)}(?![\w[\]])", doubt) is not None
    if what == "sign":
        return "opposite" in doubt and (part in doubt or "motors" in doubt or "difference" in doubt)
    if what.startswith("unit"):
        full = getattr(holder, "factor", 1.0)
        return re.search(rf"\b{holder.unit}\b", doubt) is not None and ("halves" in doubt or full == 1.0)
    if what.startswith("offset_V"):
        return any(abs(number - holder.offset_V) < 0.75 for number in numbers)  # type: ignore[union-attr]
    if what.startswith("offset"):
        return part in doubt and any(abs(number - holder.offset_deg) < 6.5 for number in numbers)  # type: ignore[union-attr]
    if what.startswith("delay_s"):
        return f"{part}'" in doubt and (
            any(abs(number - holder.delay_s) < _MAX_DELAY_s + 0.04 for number in numbers)
            or (holder.delay_s == 0.0 and "not late" in doubt)
        )
    return False


def main(arguments: Sequence[str] | None = None) -> int:
    """Write, guess and grade; 1 if a wrong entry is sure."""
    parser = argparse.ArgumentParser(prog="python -m tests.guess.grade", description=__doc__)
    parser.add_argument("--judge", action="store_true", help="the judging seeds instead of the others")
    parser.add_argument("--seed", type=int, action="append", help="only this seed")
    given = parser.parse_args(arguments)
    seeds = given.seed or (JUDGING_SEEDS if given.judge else DEVELOPMENT_SEEDS)
    grades = []
    for seed in seeds:
        with tempfile.TemporaryDirectory() as folder:
            file = write(seed, Path(folder))
            graded = grade(file)
        grades.append(graded)
        print(f"{seed} {graded.corrections} {file.about}")
        print(f"    wrong: {', '.join(graded.wrong)}; silent: {', '.join(graded.silent)}")
        for doubt in graded.doubts:
            print(f"    {doubt}")
        sys.stdout.flush()
    counts = [graded.corrections for graded in grades]
    silent = sum(len(graded.silent) for graded in grades)
    sure = sum(len(graded.wrong) for graded in grades if graded.sure)
    print(f"\nfiles: {len(grades)}; with at most one correction: {sum(count <= 1 for count in counts)}")
    print(f"corrections per file: {counts}")
    print(
        f"wrong entries: {sum(len(graded.wrong) for graded in grades)}; of these without a doubt that names"
    )
    print(f"the right value: {silent}; called sure: {sure}")
    return 1 if sure else 0


if __name__ == "__main__":
    sys.exit(main())

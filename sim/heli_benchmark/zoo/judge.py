"""Import the file of a case as a user does, and judge the result against the truth."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from unittest import mock

import numpy as np
from heli_host.ui.cli.entry import run

from heli_benchmark.zoo.case import LogCase
from heli_benchmark.zoo.compare import ImportedFlight, mistakes, row_difference
from heli_benchmark.zoo.containers import write_log

RIGHT: Final = "right"
CONFIRMED: Final = "right, after a question"
DOUBTED: Final = "doubted, for the right reason"
REFUSED: Final = "refused, for the right reason"
WRONG_REASON: Final = "refused or doubted, for a wrong reason"
SILENT: Final = "silently wrong"
SCORES: Final = (RIGHT, CONFIRMED, DOUBTED, REFUSED, WRONG_REASON, SILENT)

_DOUBTS: Final = {
    "sign": r"sign|front one|column",
    "mirror": r"sign|front one|column",
    "scale": r"unit|scale|rig|column|bias|limit|supply",
    "zero": r"zero",
    "values": r"column|time|limit|sign|still",
    "late": r"time|column",
    "clock": r"time|clock",
    "row": r"row|column|time",
    "rows": r"row|time",
}
"""Pattern of the subjects that question each kind of mistake."""
_ROW_WORDS: Final = (
    r"\d+ .*(row|line|sample|message|missing|cell)|(row|line|sample|message|missing|cell).* \d+"
)
"""Pattern of a sentence that counts rows."""
_FILE_COLUMNS: Final = {
    **{axis: f"{axis}_rad" for axis in ("elevation", "pitch", "travel")},
    **{motor: f"{motor}_V" for motor in ("front", "back")},
}


@dataclass(frozen=True)
class Score:
    """Judgement of one case."""

    name: str
    score: str
    traits: tuple[str, ...]
    detail: str
    container: str


@dataclass(frozen=True)
class _Import:
    """What one call of the import has printed and written."""

    exit_code: int
    text: str  # Standard output and standard error
    subjects: tuple[str, ...]  # Subjects of its questions
    flights: tuple[ImportedFlight, ...]
    notes: str  # Notes of the written flights


def judge_import(case: LogCase, folder: Path) -> Score:
    """Write, import and judge a case within a folder."""
    path = write_log(case, folder)
    output = folder / "imported"
    arguments = ["import", str(path), "--guess", "-o", str(output)]
    if case.gives_rig:
        arguments += ["--rig", case.rig_name]
    if case.rate_Hz:
        arguments += ["--rate", f"{case.rate_Hz:g}"]
    if case.known_columns:
        arguments += ["--profile", str(_write_known(case, path, folder / "known.toml"))]
    guessed = _run_import(arguments, output, folder / "guess.json")
    if guessed.exit_code == 0:
        return _judge_flights(case, guessed, subjects=())
    if not guessed.subjects:
        return _judge_refusal(case, guessed)
    if "currents" in case.truth.unknown and "the columns" in guessed.subjects:
        return _score(case, DOUBTED, f"asks about {'; '.join(guessed.subjects)}")
    if case.truth.refusal:
        return _score(case, WRONG_REASON, f"asks about {', '.join(guessed.subjects)}, and should refuse")
    confirmed = _run_import(
        ["import", str(path), "--profile", str(output / "profile.toml"), "-o", str(output)],
        output,
        folder / "profile.json",
    )
    if confirmed.exit_code:
        return _score(case, WRONG_REASON, f"proposal cannot be imported: {_error_line(confirmed.text)}")
    confirmed = _Import(0, guessed.text + confirmed.text, (), confirmed.flights, confirmed.notes)
    return _judge_flights(case, confirmed, guessed.subjects)


def _judge_flights(case: LogCase, imported: _Import, subjects: Sequence[str]) -> Score:
    """Judge written flights; `subjects` are what the import had asked about."""
    if case.truth.refusal:
        return _score(case, SILENT, f"imported, and should be refused ({case.truth.refusal})")
    wrong = mistakes(imported.flights, case.truth)
    unsaid = _unsaid(case, imported)
    if not wrong and not unsaid:
        return _score(
            case, CONFIRMED if subjects else RIGHT, f"asks about {'; '.join(subjects)}" if subjects else ""
        )
    if not wrong:
        return _score(case, SILENT, "; ".join(unsaid))
    asked_for = [item for item in wrong if _is_questioned(item, subjects)]
    detail = f"{'; '.join([*wrong, *unsaid])} [asks about {'; '.join(subjects) or 'nothing'}]"
    if len(asked_for) == len(wrong) and not unsaid:
        return _score(case, DOUBTED, detail)
    return _score(case, SILENT, detail)


def _is_questioned(mistake: str, subjects: Sequence[str]) -> bool:
    quantity, _, text = mistake.partition(": ")
    for kind, pattern in _DOUBTS.items():
        if re.search(rf"\b{kind}\b", text if quantity in _FILE_COLUMNS else quantity):
            return any(re.search(pattern, subject) for subject in subjects)
    return False


def _unsaid(case: LogCase, imported: _Import) -> list[str]:
    """Repairs of which the import has not said a word."""
    words = (imported.text + imported.notes).lower()
    unsaid = [
        f"{kind}: repaired without a word"
        for kind, pattern in (case.truth.reports or {}).items()
        if not re.search(pattern, words)
    ]
    difference = row_difference(imported.flights, case.truth)
    if abs(difference) > max(3, 0.002 * case.truth.row_count) and not re.search(_ROW_WORDS, words):
        unsaid.append(f"rows: {difference:+d} of {case.truth.row_count} without a word")
    return unsaid


def _judge_refusal(case: LogCase, imported: _Import) -> Score:
    line = _error_line(imported.text)
    # The remedy after the semicolon is no reason.
    reason = line.partition("; ")[0].partition(": ")[2]
    if imported.exit_code == 70:  # the exit code of the command line after an unexpected exception
        return _score(case, WRONG_REASON, f"a defect of the program: {line}")
    if case.truth.refusal and re.search(case.truth.refusal, reason):
        return _score(case, REFUSED, line)
    return _score(case, WRONG_REASON, line)


def _error_line(text: str) -> str:
    return next((line for line in text.splitlines() if line.startswith("error: ")), text[-300:])


def _score(case: LogCase, score: str, detail: str) -> Score:
    return Score(case.name, score, case.traits, detail, case.container)


def _write_known(case: LogCase, path: Path, profile: Path) -> Path:
    """Write the columns that the user knows; tables without a header have numbered columns."""
    first = 1 + case.recording.has_clock
    name = "data[{}]" if path.suffix == ".mat" else "column {}"
    lines = []
    for role, index in case.known_columns.items():
        lines += [f"[{role}]", f'column = "{name.format(int(index) + first)}"', ""]
    profile.write_text("\n".join(lines))
    return profile


def _run_import(arguments: list[str], output: Path, result: Path) -> _Import:
    for stale in output.glob("*.csv") if output.is_dir() else ():
        stale.unlink()
    printed = io.StringIO()
    with (
        contextlib.redirect_stdout(printed),
        contextlib.redirect_stderr(printed),
        # A figure takes a third of an import, and no score depends on it.
        mock.patch("heli_lab.setup.guess.figure.draw", lambda guess, flight, path: path),
    ):
        exit_code = run([*arguments, "--json", str(result)])
    content: dict[str, Any] = json.loads(result.read_text()) if result.exists() else {}
    flights = tuple(_read_flight(Path(item["file"])) for item in content.get("flights", ()))
    notes = "".join(
        path.read_text() for path in sorted(output.glob("*")) if path.suffix in (".txt", ".notes")
    )
    return _Import(exit_code, printed.getvalue(), tuple(content.get("ambiguities", {})), flights, notes)


def _read_flight(path: Path) -> ImportedFlight:
    with path.open(encoding="utf-8", newline="") as file:
        rows = csv.reader(line for line in file if not line.startswith("#"))
        names = next(rows)
        numbers = np.array([[float(cell) for cell in row] for row in rows])
    columns = dict(zip(names, numbers.T, strict=True))
    return ImportedFlight(columns["t_s"], {role: columns[name] for role, name in _FILE_COLUMNS.items()})

"""Scores of several splits in one comparison: files with the scores of each case, read and pooled."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

from heli_benchmark.entries.run import split_digest
from heli_benchmark.errors import BenchmarkError
from heli_benchmark.leaderboard.score import CaseScore
from heli_benchmark.leaderboard.summary import summarise_runs
from heli_benchmark.task import Split
from heli_benchmark.task.json_file import read_json

_KEYS: Final = ("splits", "case_scores")
_REMEDY: Final = "give a file of `heli-host benchmark score --json`"


def scores_content(split: Split, runs: Mapping[str, Sequence[CaseScore]]) -> dict[str, Any]:
    """Return the summary of runs on a split with the scores of each case, as the content of a file."""
    return _scores_file_content([split_digest(split)], runs)


def pooled_scores(files: Sequence[Path]) -> dict[str, Any]:
    """Pool files of scores: the result is that of one split with all their cases."""
    pooled: dict[str, list[CaseScore]] = {}
    origin: dict[str, Path] = {}
    for path in files:
        content = read_json(path, _REMEDY, _KEYS)
        for digest in content["splits"]:
            if digest in origin:
                raise BenchmarkError(
                    f"{origin[digest]} and {path} have scores of the same split", "give each split once"
                )
            origin[digest] = path
        runs = _scores_by_method(content["case_scores"], path)
        if pooled and set(runs) != set(pooled):
            name = sorted(set(runs) ^ set(pooled))[0]
            lacking = path if name in pooled else files[0]
            raise BenchmarkError(f"{lacking} has no method '{name}'", "score the same methods on each split")
        for name, scores in runs.items():
            pooled.setdefault(name, []).extend(scores)
    return _scores_file_content(list(origin), pooled)


def _scores_file_content(digests: list[str], runs: Mapping[str, Sequence[CaseScore]]) -> dict[str, Any]:
    """Return the content of a file of scores, with the digests of all splits in it."""
    cases = {name: [asdict(case) for case in scores] for name, scores in runs.items()}
    return {"splits": digests, **summarise_runs(runs), "case_scores": cases}


def _scores_by_method(content: Mapping[str, Any], path: Path) -> dict[str, list[CaseScore]]:
    """Read the scores by method; `path` is the file that messages name."""
    try:
        runs = {name: [_case_score(fields) for fields in scores] for name, scores in content.items()}
    except (AttributeError, KeyError, TypeError, ValueError):
        raise BenchmarkError(f"{path} has invalid scores of a case", _REMEDY) from None
    # Methods are compared case by case.
    if len({tuple(case.case for case in scores) for scores in runs.values()}) != 1 or not all(runs.values()):
        raise BenchmarkError(f"{path} does not score all methods on the same cases", _REMEDY)
    return runs


def _case_score(content: Mapping[str, Any]) -> CaseScore:
    """Read one score; JSON has lists where a score has tuples."""
    pairs = {
        "sizes": tuple((bool(within), float(score)) for within, score in content["sizes"]),
        "calibration": tuple((float(p), bool(true)) for p, true in content["calibration"]),
    }
    return CaseScore(**{**content, **pairs})

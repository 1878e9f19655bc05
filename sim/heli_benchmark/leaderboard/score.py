"""Scores of the answers of one run, case by case."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from heli_host.data.arrays import Floats

from heli_benchmark.entries.run import read_run
from heli_benchmark.leaderboard.prediction import prediction_ratio, true_errors
from heli_benchmark.reference.equation_torque import torque_correlation
from heli_benchmark.scoring.judge import MIN_VISIBILITY_STD
from heli_benchmark.task import (
    NOTHING,
    UNLISTED,
    Answer,
    AxisSeries,
    BenchmarkCase,
    Causes,
    Split,
    read_case,
)
from heli_benchmark.task.answer import check_answer

MIN_PROBABILITY: Final = 1e-3
"""Lowest probability of what was true, in the log score. With 0, one wrong certainty would decide the table;
at 0.01 a method that is 99.9 % sure would gain nothing."""
NAMED: Final = 0.5
"""Probability from which an answer names a cause: more likely hidden than not."""
_NO_SIZE: Final = ("_at_s", "_rest_rad", "_Hz")
"""Endings of parameters that are no size: moments, angles of rest and frequencies."""
INTERVAL: Final = 0.05
"""Probability outside the interval of the interval score, which is the estimate with 1.96 standard errors."""
_NORMAL: Final = 1.959964
"""Quantile of the standard normal distribution with 2.5 % above it."""


@dataclass(frozen=True)
class Truth:
    """Hidden causes of a case, by what an answer can be expected to know about them."""

    causes: frozenset[str]  # Visible causes, with `unlisted`; `nothing` if no cause is hidden
    invisible: frozenset[str]
    """Names that the case does not score: hidden causes below the limit of visibility, and `nothing` if no
    hidden cause is visible."""
    sizes: Mapping[str, float]  # Sizes of the visible causes by parameter


@dataclass(frozen=True)
class CaseScore:
    """Scores of an answer."""

    case: str  # Name of the case
    log_loss: float
    """log_loss, base_loss: Negative log-likelihood of the truth under the answer and under the base rates,
    nats."""
    base_loss: float
    first_right: bool  # Whether the most probable name is true
    all_named: bool | None  # Whether every visible cause is named; None without a visible cause
    false_names: int  # Named causes that are not hidden
    false_alarm: bool | None  # Whether a cause is named although nothing is hidden; None if something is
    sizes: tuple[tuple[bool, float], ...]
    """For each estimated size: whether it is within two standard errors, and its interval score relative to
    the true size."""
    sizes_asked: int  # Number of true sizes
    prediction: float | None
    """Prediction error on the validation flights relative to that of the true model; None if the true model
    is not in the catalogue."""
    equation: float | None
    """Correlation of the equation of the answer with the true torques; None if no unlisted cause is visible.
    """
    calibration: tuple[tuple[float, bool], ...]  # Probability and truth of each name
    cpu_s: float | None  # cpu_s, peak_MB: Cost of the answer
    peak_MB: float | None
    failure: str  # Why there is no answer; empty if there is one


def score_runs(split: Split, folders: Sequence[Path]) -> list[list[CaseScore]]:
    """Score runs; each case is read once, and its true model predicts once."""
    runs = [read_run(folder, split) for folder in folders]
    scores: list[list[CaseScore]] = [[] for _ in folders]
    for case_folder in split.cases:
        reference = _case_with_truth(split, case_folder)
        for folder, run, scored in zip(folders, runs, scores, strict=True):
            name = case_folder.name
            scored.append(_score_result(reference, run[name], f"{folder / name}.json"))
    return scores


def score_run(split: Split, folder: Path) -> list[CaseScore]:
    """Score one run, as in `score_runs`."""
    return score_runs(split, [folder])[0]


@dataclass(frozen=True)
class _CaseReference:
    """What the answers to a case are compared with."""

    case: BenchmarkCase  # The case as a method sees it
    truth: Truth  # Its scored causes
    errors: Floats | None  # (3,): Prediction errors of the true model
    torques_Nm: Mapping[str, AxisSeries]  # Torques of visible unlisted causes by flight


def _case_with_truth(split: Split, case_folder: Path) -> _CaseReference:
    """Read a case with its truth, and let the true model predict."""
    content = split.truth(case_folder.name)
    case, truth = read_case(case_folder), scored_truth(content)
    torques_Nm = split.unlisted_torques_Nm(case.name) if UNLISTED in truth.causes else {}
    return _CaseReference(case, truth, true_errors(case, content), torques_Nm)


def _score_result(reference: _CaseReference, result: Mapping[str, Any], where: str) -> CaseScore:
    """Score the result of a case; `where` is its file."""
    case, causes = reference.case, reference.case.causes
    failure = str(result.get("failure", ""))
    answer = Answer(causes.base_rates) if failure else check_answer(result["answer"], causes, where)
    prediction = (
        None
        if reference.errors is None
        else prediction_ratio(case, answer, listed_names(answer), reference.errors)
    )
    return score_answer(
        case.name,
        answer,
        reference.truth,
        causes,
        (result.get("cpu_s"), result.get("peak_MB")),
        failure,
        prediction,
        equation_correlation(answer, reference.torques_Nm),
    )


def equation_correlation(answer: Answer, torques_Nm: Mapping[str, AxisSeries]) -> float | None:
    """Return the correlation of the equation of an answer with the true torques, mean of the flights."""
    if not torques_Nm:
        return None
    correlations = []
    for name, true in torques_Nm.items():
        proposed = answer.equation_torques.get(name)
        if proposed is None or proposed.t_s[-1] < true.t_s[0] or proposed.t_s[0] > true.t_s[-1]:
            correlations.append(0.0)
            continue
        _, correlation = torque_correlation(true.t_s, true.values, proposed.t_s, proposed.values)
        correlations.append(correlation)
    return sum(correlations) / len(correlations)


def scored_truth(content: Mapping[str, Any]) -> Truth:
    """Return the scored truth of a case."""
    listed = {name: float(cause["visibility_std"]) for name, cause in content["causes"].items()}
    unlisted = [float(std) for std in content["unlisted"].values()]
    hidden = listed | ({UNLISTED: max(unlisted)} if unlisted else {})
    visible = {name for name, std in hidden.items() if std >= MIN_VISIBILITY_STD}
    invisible = set(hidden) - visible
    if not hidden:
        visible = {NOTHING}
    elif not visible:
        invisible.add(NOTHING)
    sizes = {
        name: float(value)
        for cause in visible & set(content["causes"])
        for name, value in content["causes"][cause]["parameters"].items()
        if not name.endswith(_NO_SIZE)
    }
    return Truth(frozenset(visible), frozenset(invisible), sizes)


def score_answer(
    case: str,
    answer: Answer,
    truth: Truth,
    causes: Causes,
    cost: tuple[float | None, float | None] = (None, None),
    failure: str = "",
    prediction: float | None = None,
    equation: float | None = None,
) -> CaseScore:
    """Score an answer."""
    scored = [name for name in causes.names if name not in truth.invisible]
    probabilities = {name: answer.probabilities.get(name, 0.0) for name in causes.names}
    calibration = tuple((probabilities[name], name in truth.causes) for name in scored)
    named = (
        set()
        if failure
        else {name for name in probabilities if probabilities[name] >= NAMED and name != NOTHING}
    )
    most_probable = max(probabilities, key=probabilities.__getitem__)
    visible = truth.causes - {NOTHING}
    cpu_s, peak_MB = cost
    return CaseScore(
        case,
        log_loss=_negative_log_likelihood(calibration),
        base_loss=_negative_log_likelihood(
            tuple((causes.base_rates[name], name in truth.causes) for name in scored)
        ),
        first_right=not failure and (most_probable in truth.causes or most_probable in truth.invisible),
        all_named=visible <= named if visible else None,
        false_names=len(named - truth.causes - truth.invisible),
        false_alarm=bool(named) if NOTHING in truth.causes else None,
        sizes=tuple(
            (
                abs(estimate.value - truth.sizes[name]) <= 2.0 * estimate.std,
                _interval_score(estimate.value, estimate.std, truth.sizes[name]),
            )
            for name, estimate in answer.parameters.items()
            if name in truth.sizes
        ),
        sizes_asked=len(truth.sizes),
        prediction=prediction,
        equation=equation,
        calibration=calibration,
        cpu_s=cpu_s,
        peak_MB=peak_MB,
        failure=failure,
    )


def listed_names(answer: Answer) -> list[str]:
    """Return the causes of the list that an answer names."""
    named = (name for name, probability in answer.probabilities.items() if probability >= NAMED)
    return [name for name in named if name not in (NOTHING, UNLISTED)]


def _negative_log_likelihood(pairs: tuple[tuple[float, bool], ...]) -> float:
    """Return the negative log-likelihood of pairs of a probability and whether its name is true, nats."""
    return sum(-math.log(max(p if is_true else 1.0 - p, MIN_PROBABILITY)) for p, is_true in pairs)


def _interval_score(value: float, std: float, truth: float) -> float:
    """Interval score of Gneiting and Raftery (2007), relative to the true size; lower is better."""
    low, high = value - _NORMAL * std, value + _NORMAL * std
    outside = max(low - truth, 0.0) + max(truth - high, 0.0)
    return (high - low + 2.0 / INTERVAL * outside) / abs(truth)

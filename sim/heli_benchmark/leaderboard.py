"""Summary of each method's scores over all cases, with 95 % intervals, and differences between methods.

An interval comes from a bootstrap: the cases are drawn again with replacement, and each score is computed on
each such resample. A resample is stored as the number of times that it contains each case, its weights.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path
from typing import Any, Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.files import save_figure

from heli_benchmark.entries import split_digest
from heli_benchmark.errors import BenchmarkError
from heli_benchmark.scores import CaseScore, SizeScore
from heli_benchmark.task import Split, read_json

RESAMPLES: Final = 2000
"""Bootstrap resamples. The ends of an interval then vary by less than a tenth of its width."""
_BINS: Final = (0.0, 0.05, 0.2, 0.5, 0.8, 1.0 + 1e-9)
"""Edges of the probability bins for the calibration error; the last bin includes 1."""
_SHARES: Final = ("first_right", "all_named", "false_alarms")
"""Shares of cases. Their intervals are binomial: a bootstrap of 0 of 4 cases has no width."""
_INTERVAL_PERCENTILES: Final = (2.5, 97.5)


@dataclass(frozen=True)
class CaseSums:
    """A score that is a ratio of two sums over the cases."""

    numerators: Floats  # numerators, denominators: (n,): Contribution of each case to the two sums
    denominators: Floats


def summarise_runs(runs: Mapping[str, Sequence[CaseScore]], seed: int = 0) -> dict[str, Any]:
    """Summarise runs on the same cases."""
    cases = len(next(iter(runs.values())))
    resampled_cases = np.random.default_rng(seed).integers(cases, size=(RESAMPLES, cases))
    # Row r has the number of times that resample r contains each case, shape (RESAMPLES, cases).
    counts = np.stack([np.bincount(indices, minlength=cases) for indices in resampled_cases])
    weights = counts.astype(np.float64)
    return {
        "cases": cases,
        "methods": {name: _scores_of_method(scores, weights) for name, scores in runs.items()},
        "pairs": [
            {"first": first, "second": second, **_difference_of_methods(runs[first], runs[second], weights)}
            for first, second in combinations(runs, 2)
        ],
    }


def _scores_of_method(scores: Sequence[CaseScore], weights: Floats) -> dict[str, Any]:
    """Return all scores of one method over the cases, with intervals from the resamples of `weights`, shape
    (resamples, cases).
    """
    loss, base_loss = _log_losses(scores)
    count = len(scores)
    # The score of the cases themselves gives each of them the weight 1.
    skill = _skill(loss, base_loss, np.ones((1, count)))
    sums_by_name = _case_sums(scores)
    ratios = {name: _ratio_of_sums(sums, weights) for name, sums in sums_by_name.items()}
    for name in _SHARES:
        ratios[name] |= _clopper_pearson_interval(sums_by_name[name])
    # The ratio of the prediction errors was averaged as a logarithm.
    for end in ("value", "low", "high"):
        log_ratio = ratios["prediction_error"][end]
        ratios["prediction_error"][end] = None if log_ratio is None else float(np.exp(log_ratio))
    return {
        "skill": _score_with_interval(skill, _skill(loss, base_loss, weights), count),
        **ratios,
        "calibration_error": _calibration(scores, weights),
        "cpu_s": _mean_of_known([case.cpu_s for case in scores]),
        "peak_MB": max((case.peak_MB for case in scores if case.peak_MB is not None), default=None),
        "failed": sum(bool(case.failure) for case in scores),
    }


def _skill(loss: Floats, base_loss: Floats, weights: Floats) -> Floats:
    """Return 1 - (sum of the losses) / (sum of the losses of the base rates) in each resample."""
    # Skill 1 is a perfect answer in each case, and 0 is no better than the base rates.
    return np.asarray(1.0 - weights @ loss / (weights @ base_loss))


def _log_losses(scores: Sequence[CaseScore]) -> tuple[Floats, Floats]:
    """Return the logarithmic loss of the method, and that of the base rates, in each case."""
    return np.array([case.log_loss for case in scores]), np.array([case.base_loss for case in scores])


def _case_sums(scores: Sequence[CaseScore]) -> dict[str, CaseSums]:
    """Return each score that is a ratio of two sums over cases, by name."""

    def mean_of_cases(value: Callable[[CaseScore], float | None]) -> CaseSums:
        """Average `value` over the cases in which it is not None."""
        values = [value(case) for case in scores]
        is_counted = np.array([float(number is not None) for number in values])
        return CaseSums(np.array([0.0 if number is None else float(number) for number in values]), is_counted)

    def mean_of_sizes(value: Callable[[SizeScore], float]) -> CaseSums:
        """Average `value` over all estimated sizes of all cases."""
        sums = [sum(value(size) for size in case.sizes) for case in scores]
        return CaseSums(np.array(sums, float), estimated_sizes)

    estimated_sizes = np.array([float(len(case.sizes)) for case in scores])
    true_sizes = np.array([float(case.sizes_asked) for case in scores])
    return {
        "first_right": mean_of_cases(lambda case: case.first_right),
        "all_named": mean_of_cases(lambda case: case.all_named),
        "false_names": mean_of_cases(lambda case: case.false_names),
        "false_alarms": mean_of_cases(lambda case: case.false_alarm),
        "sizes_given": CaseSums(estimated_sizes, true_sizes),
        "sizes_within": mean_of_sizes(lambda size: size.is_within),
        "interval_score": mean_of_sizes(lambda size: size.interval_score),
        "equation_correlation": mean_of_cases(lambda case: case.equation),
        "prediction_error": mean_of_cases(
            lambda case: None if case.prediction is None else np.log(case.prediction)
        ),
    }


def _ratio_of_sums(sums: CaseSums, weights: Floats) -> dict[str, Any]:
    """Return the ratio of two sums over the cases, with its bootstrap interval."""
    count = int(sums.denominators.sum())
    if not count:
        return {"value": None, "low": None, "high": None, "cases": 0}
    totals = weights @ sums.denominators
    # A resample may contain none of the cases that count.
    resampled = (weights @ sums.numerators)[totals > 0.0] / totals[totals > 0.0]
    return _score_with_interval(np.array([sums.numerators.sum() / sums.denominators.sum()]), resampled, count)


def _clopper_pearson_interval(share: CaseSums) -> dict[str, float]:
    """Return the 95 % interval of Clopper and Pearson of a share of cases."""
    from scipy.stats import binomtest

    if not share.denominators.sum():
        return {}
    test = binomtest(int(share.numerators.sum()), int(share.denominators.sum()))
    interval = test.proportion_ci(0.95, "exact")
    return {"low": float(interval.low), "high": float(interval.high)}


def _calibration(scores: Sequence[CaseScore], weights: Floats) -> dict[str, Any]:
    """Return the mean difference of probability and frequency over bins, weighted by the number of names."""
    # Almost all names of a case have a probability near 0, so the first bin is omitted.
    bins = len(_BINS) - 1
    excess, counts = np.zeros((len(scores), bins)), np.zeros((len(scores), bins))
    for case_index, case in enumerate(scores):
        for probability, is_true in case.calibration:
            bin_index = int(np.searchsorted(_BINS, probability, side="right")) - 1
            excess[case_index, bin_index] += probability - is_true
            counts[case_index, bin_index] += 1.0
    excess, counts = excess[:, 1:], counts[:, 1:]
    if not counts.sum():
        return {"value": None, "low": None, "high": None, "cases": 0}
    value = np.abs(excess.sum(axis=0)).sum() / counts.sum()
    totals = (weights @ counts).sum(axis=1)
    resampled = np.abs(weights @ excess).sum(axis=1)[totals > 0.0] / totals[totals > 0.0]
    return _score_with_interval(np.array([value]), resampled, int(counts.sum()))


def _difference_of_methods(
    first: Sequence[CaseScore], second: Sequence[CaseScore], weights: Floats
) -> dict[str, Any]:
    """Compare two methods on the same resampled cases."""
    (loss_a, base), (loss_b, _) = _log_losses(first), _log_losses(second)
    unweighted = np.ones((1, len(base)))
    skill = _score_with_interval(
        _skill(loss_a, base, unweighted) - _skill(loss_b, base, unweighted),
        _skill(loss_a, base, weights) - _skill(loss_b, base, weights),
        len(base),
    )
    named_a, named_b = _case_sums(first)["all_named"], _case_sums(second)["all_named"]
    all_named = CaseSums(named_a.numerators - named_b.numerators, named_a.denominators)
    return {"skill": skill, "all_named": _ratio_of_sums(all_named, weights)}


def _score_with_interval(value: Floats, resampled: Floats, cases: int) -> dict[str, Any]:
    """Return a score, `value` of shape (1,), with the 95 % interval of its `resampled` values."""
    low, high = np.percentile(resampled, _INTERVAL_PERCENTILES)
    return {"value": float(value[0]), "low": float(low), "high": float(high), "cases": cases}


def _mean_of_known(values: Sequence[float | None]) -> float | None:
    """Return the mean of the `values` that are known; None if none is."""
    known = [value for value in values if value is not None]
    return float(np.mean(known)) if known else None


_COLUMNS: Final = (
    ("skill", "skill", "{:.2f}"),
    ("first_right", "first name right", "{:.0%}"),
    ("all_named", "every cause named", "{:.0%}"),
    ("false_names", "false names per case", "{:.2f}"),
    ("false_alarms", "false alarms", "{:.0%}"),
    ("sizes_given", "sizes given", "{:.0%}"),
    ("sizes_within", "sizes within 2 standard errors", "{:.0%}"),
    ("interval_score", "interval score", "{:.2f}"),
    ("prediction_error", "prediction error", "{:.2f}"),
    ("equation_correlation", "equation correlation", "{:.2f}"),
    ("calibration_error", "calibration error", "{:.2f}"),
)
_LOWEST_DRAWN_SKILL: Final = -1.0
"""Lowest skill that is drawn to scale; an arrow and a number show a lower one."""
_PANELS: Final = (
    ("skill", "skill (truth known: 1)"),
    ("all_named", "every cause named"),
    ("false_alarms", "false alarms, nothing hidden"),
)


def comparison_table(summary: Mapping[str, Any]) -> str:
    """Return the table as Markdown, the best skill first."""
    heads = ["method", *(title for _, title, _ in _COLUMNS), "CPU s per case", "peak MB", "failed"]
    lines = ["| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
    for name in _methods_by_skill(summary):
        method_scores = summary["methods"][name]
        cells = [_score_cell(method_scores[key], form) for key, _, form in _COLUMNS]
        cost = [
            "-" if method_scores[key] is None else f"{method_scores[key]:.3g}" for key in ("cpu_s", "peak_MB")
        ]
        lines.append(f"| {name} | " + " | ".join([*cells, *cost, str(method_scores["failed"])]) + " |")
    return "\n".join(lines)


def pair_lines(summary: Mapping[str, Any]) -> list[str]:
    """Return the comparisons by pairs as lines of text."""
    lines = []
    for pair in summary["pairs"]:
        parts = []
        for key, word, form in (("skill", "skill", "{:+.2f}"), ("all_named", "every cause named", "{:+.0%}")):
            parts.append(f"{word} {_score_cell(pair[key], form)}")
        lines.append(f"{pair['first']} minus {pair['second']}: {', '.join(parts)}")
    return lines


def report_text(summary: Mapping[str, Any]) -> str:
    """Return the table, the comparisons by pairs and the number of cases as Markdown."""
    pairs = "\n".join(f"- {line}" for line in pair_lines(summary))
    splits = len(summary["splits"])
    splits_text = "one split" if splits == 1 else f"{splits} splits"
    return f"{comparison_table(summary)}\n\n{pairs}\n\nCases: {summary['cases']}, of {splits_text}.\n"


def draw_comparison(summary: Mapping[str, Any], path: Path) -> None:
    """Draw the skill, the named causes and the false alarms of each method with their intervals."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    names = _methods_by_skill(summary)[::-1]
    figure, axes = plt.subplots(1, len(_PANELS), figsize=(9.0, 0.8 + 0.36 * len(names)), sharey=True)
    for axis, (key, title) in zip(axes, _PANELS, strict=True):
        for row, name in enumerate(names):
            score = summary["methods"][name][key]
            if score["value"] is None:
                continue  # no case of the split has this score
            colour = "tab:blue" if name == "ours" else "0.35"
            axis.plot([score["low"], score["high"]], [row, row], color=colour, linewidth=2.0)
            if score["value"] < _LOWEST_DRAWN_SKILL:  # the other scores are shares, never below 0
                axis.plot(_LOWEST_DRAWN_SKILL, row, "<", color=colour)
                text_x = _LOWEST_DRAWN_SKILL + 0.1  # right of the arrow
                axis.text(text_x, row, f"{score['value']:.1f}", color=colour, va="center", fontsize=9)
            else:
                axis.plot(score["value"], row, "o", color=colour)
        axis.set_title(title, fontsize=10)
        axis.grid(axis="x", color="0.9")
        axis.set_axisbelow(True)
    skill_axis, *share_axes = axes
    skill_axis.axvline(0.0, color="0.6", linewidth=1.0)  # the skill of the base rates
    # All limits leave a margin for the markers at the ends.
    skill_axis.set_xlim(_LOWEST_DRAWN_SKILL - 0.08, 1.08)
    skill_axis.set_yticks(range(len(names)), [name.replace("_", " ") for name in names])
    for axis in share_axes:
        axis.set_xlim(-0.04, 1.04)
    figure.tight_layout()
    save_figure(figure, path, dpi=110)
    plt.close(figure)


def _methods_by_skill(summary: Mapping[str, Any]) -> list[str]:
    return sorted(summary["methods"], key=lambda name: -summary["methods"][name]["skill"]["value"])


def _score_cell(of: Mapping[str, Any], form: str) -> str:
    """Return a score with its interval; a dash if there is none."""
    if of["value"] is None:
        return "-"
    value, low, high = (form.format(of[key]) for key in ("value", "low", "high"))
    return f"{value} ({low} to {high})"


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
        "sizes": tuple(SizeScore(bool(within), float(score)) for within, score in content["sizes"]),
        "calibration": tuple((float(p), bool(true)) for p, true in content["calibration"]),
    }
    return CaseScore(**{**content, **pairs})

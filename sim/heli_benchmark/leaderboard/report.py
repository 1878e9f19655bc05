"""The table and the figure of a comparison."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from heli_host.data.files import save_figure

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
_LEAST: Final = -1.0
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
                continue
            colour = "tab:blue" if name == "ours" else "0.35"
            axis.plot([score["low"], score["high"]], [row, row], color=colour, linewidth=2.0)
            if score["value"] < _LEAST:
                axis.plot(_LEAST, row, "<", color=colour)
                axis.text(_LEAST + 0.1, row, f"{score['value']:.1f}", color=colour, va="center", fontsize=9)
            else:
                axis.plot(score["value"], row, "o", color=colour)
        axis.set_title(title, fontsize=10)
        axis.grid(axis="x", color="0.9")
        axis.set_axisbelow(True)
    axes[0].axvline(0.0, color="0.6", linewidth=1.0)
    axes[0].set_xlim(_LEAST - 0.08, 1.08)
    axes[0].set_yticks(range(len(names)), [name.replace("_", " ") for name in names])
    for axis in axes[1:]:
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

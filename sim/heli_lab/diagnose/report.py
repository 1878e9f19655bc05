"""The report of a diagnosis: one HTML page that needs no other file, and its figures as PNG."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from heli_lab.diagnose import figures
from heli_lab.diagnose.insufficient_excitation import InsufficientExcitation
from heli_lab.diagnose.result import Diagnosis
from heli_lab.diagnose.serialize import to_json
from heli_lab.diagnose.summary import summary
from heli_lab.identify.result import rounded
from heli_lab.page import escaped, folder_with, image, table, write_page

_TITLES: Final = {
    "explained": "Nothing is missing",
    "cause_found": "Cause found",
    "ambiguous": "Cause found, but not told apart from others",
    "unexplained": "Something is missing, and it is none of what is known",
}
_WHEN: Final = ("before", "after")


def write_report(diagnosis: Diagnosis, folder: str | Path) -> Path:
    """Write index.html, result.json and the figures as PNG into a `folder`, made if it is missing; return the
    page.
    """
    numbers = to_json(diagnosis)
    folder = folder_with(numbers, folder)
    before, after = diagnosis.judgement.before[0].fit, diagnosis.judgement.after[0].fit
    size = figures.figure_of_size(diagnosis)
    judged = "a flight that no fit saw" if diagnosis.after.held_out_fit else "the flight that was fitted"
    label = diagnosis.verdict.label
    sections = [
        f"<h1>{_TITLES[label]}</h1>",
        f'<p class="verdict {label}">{escaped(summary(diagnosis))}{escaped(_gained(diagnosis))}</p>',
        f"<h2>Measured against simulated, on {judged}</h2>",
        _gain(numbers["gain"]),
        image(
            figures.figure_of_horizons(diagnosis.judgement.horizons),
            folder / "horizons.png",
            "errors over the horizon",
        ),
        _calibration(numbers["gain"]["calibration"]),
        image(figures.figure_of_windows(before, after), folder / "windows.png", "worst windows"),
        image(figures.figure_of_flight(before, after), folder / "flight.png", "measured against simulated"),
        "<h2>What was found</h2>",
        _causes(numbers["causes"], folder),
        *([image(size, folder / "size.png", "acceleration by each cause")] if size is not None else []),
        "<h2>What is left over</h2>",
        _residual(numbers["residual"]),
        image(figures.figure_of_torque(diagnosis), folder / "torque.png", "torque that the model lacks"),
        _remains(diagnosis, numbers, folder),
        "<h2>What was tried</h2>",
        image(
            figures.figure_of_ranking(diagnosis.search.rounds), folder / "ranking.png", "candidates by score"
        ),
        _ranking(numbers["ranking"]),
        *_next(numbers["next_flight"]),
        "<h2>What was used</h2>",
        _used(numbers),
    ]
    return write_page(folder, f"Diagnosis: {_TITLES[label]}", sections)


def write_insufficient_excitation(result: InsufficientExcitation, folder: str | Path) -> Path:
    """Write the page of flights without excitation, and result.json, into a `folder`, made if it is missing;
    return the page.
    """
    numbers = to_json(result)
    folder = folder_with(numbers, folder)
    title = "These flights excite nothing"
    sections = [
        f"<h1>{title}</h1>",
        f'<p class="verdict ambiguous">{escaped(summary(result))}</p>',
        "<h2>What cannot be known from them</h2>",
        f"<p>Any of these effects, or none, may be there: {escaped(', '.join(result.undetectable))}.</p>",
        f"<p>Parameters that they do not identify: {escaped(', '.join(result.unidentifiable))}.</p>",
        *_next(numbers["next_flight"]),
    ]
    return write_page(folder, f"Diagnosis: {title}", sections)


def _gain(gain: dict[str, Any]) -> str:
    rows = [
        [
            axis,
            f"{one['before']:.3g}",
            f"{one['after']:.3g}",
            f"{one['ratio']:.2f}",
            f"{one['interval95'][0]:.2f} to {one['interval95'][1]:.2f}",
        ]
        for axis, one in gain["axis"].items()
    ]
    heads = ["axis", "before [deg]", "after [deg]", "ratio", "95 % interval of the ratio"]
    return (
        table(heads, rows)
        + f'<p class="note">{escaped(gain["metric"])}; bootstrap intervals, windows resampled.</p>'
    )


def _calibration(flights: Sequence[dict[str, Any]]) -> str:
    """What was found from the beginning of each validation flight."""
    parts = []
    for one in flights:
        if not one["after"]:
            continue
        rows = [
            [
                name,
                f"{rounded(after['prior']['value'], after['prior']['std'])} ± {after['prior']['std']:.2g}",
                *(
                    f"{rounded(n['value'], n['std'])} ± {rounded(n['std'], n['std'])}"
                    for n in (before, after)
                ),
                after["unit"],
            ]
            for (name, after), before in zip(one["after"].items(), one["before"].values(), strict=True)
        ]
        parts.append(
            table(["of this flight alone", "beforehand, after", "found, before", "after", "unit"], rows)
            + f'<p class="note">{escaped(one["flight"])}: zeros and constant torques from its first '
            f"{one['calibrated_s']:.1f} s of free flight; the {one['judged_s']:.1f} s after them are judged. "
            "Windows of each horizon start from the state that fits them best.</p>"
        )
    return "".join(parts)


def _gained(diagnosis: Diagnosis) -> str:
    """What the extension gains on the axis that gains most, as a sentence."""
    if not diagnosis.extended.candidates:
        return ""
    axis, best = min(diagnosis.gains.items(), key=lambda one: one[1].ratio)
    low, high = best.interval95
    where = "on flights that no fit saw" if diagnosis.after.held_out_fit else "on the flights fitted"
    return (
        f" With it the 2 s free run is off by {best.after_deg:.2g} deg in {axis} instead of "
        f"{best.before_deg:.2g} {where}: {best.ratio:.2f} times as much ({low:.2f} to {high:.2f})."
    )


def _equation(latex: str, path: Path) -> str:
    figure = figures.figure_of_equation(latex)
    if figure is None:
        return f"<p>Equation: <code>{escaped(latex)}</code></p>"
    return image(figure, path, latex)


def _causes(causes: Sequence[dict[str, Any]], folder: Path) -> str:
    if not causes:
        return "<p>No effect of the catalogue.</p>"
    parts = []
    for one in causes:
        sentence = one["sentence"][:1].upper() + one["sentence"][1:]
        rows = [_number(name, n) for name, n in one["parameters"].items()]
        unclear = (
            f" It could as well be {escaped(', '.join(one['ambiguous_with']))}."
            if one["ambiguous_with"]
            else ""
        )
        evidence = ", ".join(
            f"{escaped(name.replace('_', ' '))} {value:.3g}"
            for name, value in one["evidence"].items()
            if isinstance(value, float)
        )
        parts.append(
            f"<h3>{escaped(one['effect'])}</h3><p><b>{escaped(sentence)}.</b> Confidence "
            f"{one['confidence']:.2f}.{unclear}</p>"
            + _equation(one["equation"], folder / f"equation-{one['effect']}.png")
            + table(["parameter", "value ± std", "unit"], rows)
            + f'<p class="note">Evidence: {evidence}.</p>'
        )
    return "".join(parts)


def _number(name: str, number: dict[str, Any]) -> list[str]:
    value, std = number["value"], number["std"]
    return [name, f"{rounded(value, std)} ± {rounded(std, std) if std else 'fixed'}", number["unit"]]


def _residual(residual: dict[str, Any]) -> str:
    role = "held_out" if "held_out" in residual["white"] else "train"
    correlation = residual["correlation"][role]
    rows = [
        [
            axis,
            *(f"{one[when]:.3f}" for when in _WHEN),
            *(f"{correlation[when][axis]:.2f}" for when in _WHEN),
            "yes" if residual["white"][role]["after"][axis] else "no",
        ]
        for axis, one in residual["axis"].items()
    ]
    whole = residual["normalised"]
    rows.append(["all", *(f"{whole[when]:.3f}" for when in _WHEN), "", "", ""])
    rows.append(["all, held out", *(f"{whole[f'held_out_{when}']:.3f}" for when in _WHEN), "", "", ""])
    where = "held out" if role == "held_out" else "fitted"
    note = (
        "Root mean square error of the flight fitted in standard deviations of the quantisation: 1 when "
        f"nothing is left. Autocorrelation over 0.1 s in the flight {where}; white when it is "
        "within three standard deviations of that of white noise."
    )
    heads = ["axis", "before", "after", "autocorrelation before", "after", "white after"]
    return table(heads, rows) + f'<p class="note">{note}</p>'


def _remains(diagnosis: Diagnosis, numbers: dict[str, Any], folder: Path) -> str:
    missing = numbers["unexplained"]
    curves = diagnosis.curves
    text = ""
    if missing is not None:
        depends = "".join(f"<li>{escaped(one)}</li>" for one in missing["correlates_with"])
        text = (
            f"<p>No effect explains what foretells the motion about {escaped(missing['axis'])}: "
            f"log-likelihood ratio {missing['log_likelihood_gain']:.0f} nats. The strongest first:</p>"
            f"<ul>{depends}</ul>"
        )
    if curves:
        said = "; ".join(curve.what for curve in curves)
        text += (
            f"<p>In its place the model was given a plain curve: {escaped(said)}. It is in no rig. "
            "With it the free run would be off by this much:</p>"
            + _gain({"axis": missing["gain_with_splines"], "metric": numbers["gain"]["metric"]})
            + image(
                figures.figure_of_curves(curves), folder / "curves.png", "curve in the place of the cause"
            )
        )
    rows = [
        [
            axis,
            f"{1e3 * one['gust_Nm']:.2g}",
            f"{one['memory_s']:.2g}",
            f"{1e3 * one['drift_Nm']:.2g}",
            f"{one['log_likelihood_ratio']:.0f}",
        ]
        for axis, one in numbers["weather"].items()
    ]
    heads = ["axis", "gusts [mN m]", "that last [s]", "drift [mN m]", "log-likelihood ratio over none"]
    innovations = numbers["residual"]["innovations"]
    worst = max(abs(value) for values in innovations["autocorrelation"].values() for value in values)
    return (
        text
        + "<p>Weather, torques by chance that no model foretells:</p>"
        + table(heads, rows)
        + '<p class="note">Innovations, what each measurement shows that those before it did not '
        f"foretell, are correlated by {worst:.2f} at most over {innovations['lags_s'][0]:.2g} to "
        f"{innovations['lags_s'][-1]:.2g} s; white noise would stay below {innovations['bound']:.2f}.</p>"
    )


def _ranking(ranking: Sequence[dict[str, Any]]) -> str:
    def cell(value: float | None) -> str:
        return "" if value is None else f"{value:.0f}"

    rows = [
        [
            f"{one['round']}: {one['candidate']}{' (taken)' if one['taken'] else ''}",
            cell(one["score"]),
            cell(one["train"]),
            cell(one["penalty"]),
        ]
        for one in ranking
        if one["train"] is not None or one["score"] > 3.0
    ]
    note = (
        "Log-likelihood ratios, nats. The penalty (BIC) is for parameters and for the number of candidates."
    )
    return (
        table(["round: candidate", "screened", "refitted", "penalty"], rows) + f'<p class="note">{note}</p>'
    )


def _next(flight: dict[str, str] | None) -> list[str]:
    if flight is None:
        return []
    return [
        "<h2>The flight that would tell more</h2>",
        f"<p>{escaped(flight['why'])}</p><pre>{escaped(flight['plan'])}</pre>",
    ]


def _used(numbers: dict[str, Any]) -> str:
    parts = []
    for one in numbers["flights"]:
        role = "fitted" if one["role"] == "train" else "held out"
        spans = ", ".join(f"{a:.1f} to {b:.1f} s" for a, b in one["used"])
        notes = "".join(f" {escaped(note)}." for note in one["notes"])
        parts.append(
            f"<p>{escaped(one['flight'])}, {role}: {one['seconds_used']:.1f} s used ({spans}).{notes}</p>"
        )
        rows = [[f"{c['from_s']:.2f}", f"{c['to_s']:.2f}", c["why"]] for c in one["left_out"]]
        if rows:
            parts.append(table(["left out from [s]", "to [s]", "because"], rows))
    parts += [
        f"<p><b>{escaped(caution[:1].upper() + caution[1:])}.</b></p>" for caution in numbers["cautions"]
    ]
    parts.append(f"<p>It took {numbers['seconds_taken']:.1f} s.</p>")
    return "".join(parts)

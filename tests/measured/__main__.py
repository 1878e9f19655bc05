"""Tables and figures of docs/validation/measured-flights.md: ``python -m tests.measured``."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from heli_host.data.log.comparison import table_lines
from heli_host.data.log.reader import read_flight
from heli_lab.diagnose import diagnose, to_json
from heli_lab.explain.prediction import HORIZONS
from heli_lab.fit.identification import trace
from heli_lab.fit_inputs import model_of
from heli_lab.report.diagnosis.text import SHARE_HEADS, error_share_rows, error_share_sentences, share_heading
from heli_lab.watch.error_shares import error_shares
from heli_lab.watch.saved_rig import Forecaster, JudgedFlight, at_horizon, growing_axes, saved_rig
from heli_sim.model import MultibodyModel
from heli_sim.model.effect import AXES
from heli_sim.rig import load_rig

from tests.field.cases import NO_DATA
from tests.measured.pairs import (
    MEASURED,
    PAIRS,
    RIG,
    FROM_s,
    LANDS_s,
    PairFit,
    add_pairs,
    cross_validated,
    fit_pair,
    flights,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_MEASURED, _BEFORE, _AFTER = "#30343a", "#d1495b", "#0b5fa5"


def figure_of_pair(before: PairFit, after: PairFit, title: str) -> Figure:
    """Draw a flight that no fit saw: pitch and travel, measured and predicted in runs of two seconds."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 5.2))
    angle, pitch, travel = figure.subplots(3, 1, sharex=True, height_ratios=[2, 1.3, 1.3])
    figure.subplots_adjust(left=0.085, bottom=0.09, right=0.985, top=0.93, hspace=0.12)
    figure.suptitle(title, fontsize=10)
    for fitted, colour, label in ((before, _BEFORE, "baseline"), (after, _AFTER, "extended")):
        seen = trace(fitted.run.fit)
        t_s = seen.t_s - seen.t_s[0]
        error_deg = np.rad2deg(seen.measured_rad - seen.predicted_rad)
        if fitted is before:
            angle.plot(
                t_s, np.rad2deg(seen.measured_rad[:, 1]), ".", ms=1.5, color=_MEASURED, label="measured"
            )
        for number, window in enumerate(seen.windows):
            # Each run starts from the state that fits it best; a line across two runs would hide that.
            once = label if number == 0 else None
            angle.plot(
                t_s[window], np.rad2deg(seen.predicted_rad[window, 1]), color=colour, lw=0.9, label=once
            )
            pitch.plot(t_s[window], error_deg[window, 1], color=colour, lw=0.9)
            travel.plot(t_s[window], error_deg[window, 2], color=colour, lw=0.9)
    labels = ("pitch / deg", "pitch error / deg", "travel error / deg")
    for axes, label in zip((angle, pitch, travel), labels, strict=True):
        axes.set_ylabel(label, fontsize=8)
        axes.tick_params(labelsize=8)
        axes.grid(alpha=0.25)
        axes.margins(x=0.01)
    angle.legend(loc="upper right", fontsize=8, ncol=3, frameon=False, markerscale=4)
    travel.set_xlabel("time in free flight / s", fontsize=8)
    return figure


def figure_of_sizes(sizes: Mapping[str, Sequence[tuple[float, float]]], names: Sequence[str]) -> Figure:
    """Draw each effect's size on each machine, learned from either flight of its pair."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 2.9))
    panels = figure.subplots(1, len(sizes), squeeze=False)[0]
    figure.subplots_adjust(left=0.07, bottom=0.2, right=0.985, top=0.88, wspace=0.3)
    place = np.arange(len(names))
    for axes, (label, values) in zip(panels, sizes.items(), strict=True):
        for flight, colour in ((0, _AFTER), (1, _BEFORE)):
            value = np.array(values[flight::2])
            where = place + 0.16 * (flight - 0.5)
            which = ("learned from the first flight", "from the second")[flight]
            axes.errorbar(where, value[:, 0], 2 * value[:, 1], fmt="o", ms=4, color=colour, lw=1, label=which)
        axes.axhline(0, color="#9aa0a6", lw=0.8)
        axes.set_title(label, fontsize=9)
        axes.set_xticks(place, names, fontsize=7, rotation=12)
        axes.tick_params(axis="y", labelsize=8)
        axes.grid(axis="y", alpha=0.25)
    panels[0].legend(fontsize=7, frameon=False, loc="upper left")
    return figure


FIGURES = Path(__file__).resolve().parents[2] / "docs" / "figures"
SIZES = {
    "rotor_lag_s": "rotor_lag: T / s",
    "gyroscopic_torque_m_s": "gyroscopic_torque: h / (N m s/N)",
    "edgewise_flow_s_per_m": "edgewise_flow: c / (s/m)",
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Fit, print and draw."""
    parser = argparse.ArgumentParser(prog="python -m tests.measured", description=__doc__)
    add_pairs(parser)
    parser.add_argument("--diagnose", action="store_true", help="let the search name the causes")
    parser.add_argument("--figures", type=Path, default=FIGURES, help="folder to draw into")
    given = parser.parse_args(arguments)
    if not MEASURED.exists():
        print(NO_DATA)
        return 2
    pairs = given.pairs or list(PAIRS)
    if given.diagnose:
        worse_axes = 0
        for pair in pairs:
            for exchanged in (False, True):
                text, worse_axes_of_pair = _diagnosed(pair, exchanged)
                print(text, flush=True)
                worse_axes += worse_axes_of_pair
        print(f"axes whose forecast at 1 s grows by more than 10 % in the saved rig: {worse_axes}")
        return 0
    full_fits: list[tuple[str, PairFit]] = []  # With all effects, by the name of the pair
    print("two seconds ahead, degrees rms (ratio to the baseline and its 95 % interval):")
    for pair in pairs:
        # Each list begins with the baseline, and ends with all effects.
        forward_fits, backward_fits = fit_pair(pair), fit_pair(pair, back=True)
        for forward, backward in zip(forward_fits, backward_fits, strict=True):
            print(_row(pair, forward), _row(pair + ", back", backward), sep="\n", flush=True)
        full_fits += [(pair, forward_fits[-1]), (pair + ", back", backward_fits[-1])]
        title = f"{PAIRS[pair][1]}, predicted two seconds ahead from what {PAIRS[pair][0]} taught"
        figure = figure_of_pair(forward_fits[0], forward_fits[-1], title)
        figure.savefig(given.figures / f"measured-{pair}.png", dpi=90)
    print(f"ratios {', '.join(HORIZONS)} s ahead; over the same model taught by the judging flight, 2 s:")
    for name, pair_fit in full_fits:
        print(_ahead(name, pair_fit), flush=True)
    if pairs == list(PAIRS):
        sizes = {
            label: [(pair_fit.fit.params[name], pair_fit.fit.std[name]) for _, pair_fit in full_fits]
            for name, label in SIZES.items()
        }
        figure_of_sizes(sizes, pairs).savefig(given.figures / "measured-sizes.png", dpi=90)
    return 0


def _row(pair: str, pair_fit: PairFit) -> str:
    """A line of the first table: errors, ratios with their intervals, and the effects' numbers."""
    fit = pair_fit.fit
    cells = [pair, ", ".join(pair_fit.effects) or "baseline, refitted"]
    for axis in AXES:
        of = pair_fit.gain["2"][axis]
        low, high = of.interval95
        cells.append(f"{of.after_deg:.2f} ({of.ratio:.2f}: {low:.2f} to {high:.2f})")
    cells.append(", ".join(f"{fit.params[n]:.4f} +- {fit.std[n]:.4f}" for n in SIZES if n in fit.params))
    return "| " + " | ".join(cells) + " |"


def _ahead(pair: str, pair_fit: PairFit) -> str:
    """A line of the second table: ratios at each horizon, and over what the judging flight itself teaches."""
    replicated = cross_validated(pair_fit)["2"]
    ratios = [", ".join(f"{pair_fit.gain[key][axis].ratio:.2f}" for key in HORIZONS) for axis in AXES]
    return "| " + " | ".join([pair, *ratios, *(f"{replicated[axis].ratio:.2f}" for axis in AXES)]) + " |"


def _diagnosed(pair: str, exchanged: bool) -> tuple[str, int]:
    """Diagnose a pair, perhaps with the flights exchanged: the result in words, and the number of axes that
    the saved rig forecasts worse 1 s ahead by more than 10 %.
    """
    train, held_out = flights(pair, exchanged)
    labels = list(reversed(PAIRS[pair])) if exchanged else list(PAIRS[pair])
    diagnosis = diagnose(MultibodyModel(), load_rig(RIG), [train], [held_out], labels=labels)
    answer = to_json(diagnosis)
    title = f"{pair}{', back' if exchanged else ''}: {answer['verdict']}"
    fitted, judged = (
        [JudgedFlight(label, read_flight(MEASURED / f"{label}.csv.gz"), (FROM_s, LANDS_s.get(label, None)))]
        for label in labels
    )
    forecast = Forecaster(judged, model_of, load_rig(RIG))
    shares = error_shares(diagnosis, forecast, lambda: fitted)
    saved = saved_rig(diagnosis, "saved", forecast, with_unconfirmed=False)
    errors = at_horizon(forecast(saved.rig), forecast(diagnosis.rig("plain", only=())))
    parts = [
        f"{share_heading(shares)}:",
        *table_lines([SHARE_HEADS, *error_share_rows(shares)]),
        *error_share_sentences(shares, diagnosis.label),
        *(cause.sentence for cause in saved.left_out),
    ]
    lines = [title, *map(_cause_text, answer["causes"]), *_gain_lines(answer["gain"]["horizons"]), *parts]
    return "\n  ".join(lines), len(growing_axes(errors, forecast.count_deg))


def _cause_text(cause: Mapping[str, Any]) -> str:
    """Name a cause with its confidence and its parameters."""
    parameters = ", ".join(
        f"{name} {estimate['value']:.4f} +- {estimate['std']:.4f}"
        for name, estimate in cause["parameters"].items()
    )
    return f"{cause['effect']} (confidence {cause['confidence']:.2f}; {parameters}){_confirmed(cause)}"


def _gain_lines(horizons: Mapping[str, Any]) -> Iterator[str]:
    """State the errors before and after at each horizon."""
    for horizon_s, horizon in horizons.items():
        for axis, reduction in horizon["axis"].items():
            low, high = reduction["interval95"]
            yield (
                f"{horizon_s} s: {axis} {reduction['before']:.3f} to {reduction['after']:.3f}, "
                f"ratio {reduction['ratio']:.2f} ({low:.2f} to {high:.2f})"
            )


def _confirmed(cause: Mapping[str, Any]) -> str:
    """Whether a cause is confirmed, if that was tested."""
    if "confirmed" not in cause:
        return ""
    return " confirmed" if cause["confirmed"] else f" not confirmed: {cause['replication']['why_not']}"


if __name__ == "__main__":
    sys.exit(main())

"""Section of the page about the residuals: errors in standard deviations of the quantisation, whiteness."""

from __future__ import annotations

from typing import Any, Final

_BEFORE_AFTER: Final = ("before", "after")


def residual_section(residual: dict[str, Any]) -> dict[str, Any]:
    """Return the table of normalised errors and autocorrelations before and after, and a note on it."""
    role = "held_out" if "held_out" in residual["white"] else "train"
    correlation = residual["correlation"][role]
    rows = [
        [
            axis,
            *(f"{errors[when]:.3f}" for when in _BEFORE_AFTER),
            *(f"{correlation[when][axis]:.2f}" for when in _BEFORE_AFTER),
            "yes" if residual["white"][role]["after"][axis] else "no",
        ]
        for axis, errors in residual["axis"].items()
    ]
    normalised = residual["normalised"]
    rows.append(["all", *(f"{normalised[when]:.3f}" for when in _BEFORE_AFTER), "", "", ""])
    rows.append(
        ["all, held out", *(f"{normalised[f'held_out_{when}']:.3f}" for when in _BEFORE_AFTER), "", "", ""]
    )
    flight_role = "held-out" if role == "held_out" else "fitted"
    innovations = residual["innovations"]
    max_autocorrelation = max(
        abs(value) for values in innovations["autocorrelation"].values() for value in values
    )
    return {
        "rows": rows,
        "note": "The error is the root mean square in the fitted flight, in standard deviations of the "
        "quantisation: 1 if nothing is missing. The autocorrelation is over 0.1 s in the "
        f"{flight_role} flight; it is white if it is within three standard deviations of that of white "
        "noise. Innovations (one-step prediction errors) have an autocorrelation of at most "
        f"{max_autocorrelation:.2f} over "
        f"{innovations['lags_s'][0]:.2g} to {innovations['lags_s'][-1]:.2g} s; white noise would stay below "
        f"{innovations['bound']:.2f}.",
    }

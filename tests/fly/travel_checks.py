"""How far the check of a silent travel encoder moves a healthy arm: ``python -m tests.fly.travel_checks``.

Each rig hovers in simulation, with the check and without it (`travel_silence_s` = 0).
"""

from collections.abc import Mapping, Sequence
from typing import Any, Final, NamedTuple

import heli_host
import numpy as np

RIGS: Final[Mapping[str, str]] = {
    "the paper's": "",
    "with a rotor lag of 0.12 s": "&effect=rotor_lag=0.12",
    "with dry friction of travel": "&effect=coulomb_friction.travel",
}
_SETTLES_s, _HOVERS_s = 10.0, 110.0
_ELEVATION_deg, _TRAVEL_deg = 4.4, -9.2


class Hover(NamedTuple):
    """Error of travel of a hover that had settled, and the checks in it."""

    mean_square_deg2: float
    largest_deg: float
    checks: int


def hover(effect: str, seed: int, silence_s: float | None = None) -> Hover:
    """Hover in simulation, with `effect` at the end of the address of the board and its parameter
    `travel_silence_s`; None: the board's own.
    """
    events: list[Any] = []
    with heli_host.connect(f"sil://?seed={seed}{effect}") as heli:
        if silence_s is not None:
            heli.params["travel_silence_s"] = silence_s
        heli.on_event(events.append)
        heli.take_off()
        heli.setpoint(elevation_deg=_ELEVATION_deg, travel_deg=_TRAVEL_deg)
        heli.wait(_SETTLES_s)
        events.clear()
        heli.wait(_HOVERS_s)
        error_deg = np.degrees(heli.samples(last_s=_HOVERS_s).travel_rad) - _TRAVEL_deg
    # Each check sends two events: its beginning and its answer.
    checks = sum(event.kind == "travel_probe" for event in events) // 2
    return Hover(float(np.mean(error_deg**2)), float(np.abs(error_deg).max()), checks)


def rows(seeds: Sequence[int]) -> list[str]:
    """Return a row of the table for each rig, as Markdown."""
    table = []
    for name, effect in RIGS.items():
        cells = []
        for silence_s in (None, 0.0):
            hovers = [hover(effect, seed, silence_s) for seed in seeds]
            checks = np.mean([each.checks for each in hovers])
            rms_deg = np.sqrt(np.mean([each.mean_square_deg2 for each in hovers]))
            largest_deg = max(each.largest_deg for each in hovers)
            cells.append(f"{checks:.1f} | {rms_deg:.2f} | {largest_deg:.1f}")
        table.append(f"| {name} | {' | '.join(cells)} |")
    return table


if __name__ == "__main__":
    print("\n".join(rows(seeds=(1, 2, 3, 4))))

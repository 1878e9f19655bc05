"""Functions that run cases: flights, fits, diagnoses and gain checks on simulated rigs. Each returns the
result for the settings of a case.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from heli_host.flight import Flight
from heli_host.log.summary import FlightSummary
from heli_host.parameter_file import read_parameter_set
from heli_sim.model import MultibodyModel
from heli_sim.model.base import Effect, Model
from heli_sim.model.effects import catalogue, effects_of, effects_with, parse_effects
from heli_sim.model.named import model_named
from heli_sim.model.parts import AXES
from heli_sim.plant import Plant
from heli_sim.rig import Rig, load_rig

from heli_lab.campaign.case import Cell
from heli_lab.campaign.draw import Drawn, drawn
from heli_lab.simulated_board import connected, fly_and_read, world_of

Settings = Mapping[str, Any]
Result = tuple[dict[str, Cell], Any]
"""A case's row, and all else."""

WORKS: Final = {name: f"{__name__}:{name}" for name in ("fly", "identify", "diagnose", "gains")}
"""Functions by the word that a campaign's file has for them."""
WORST: Final = {
    "fly": "travel_rms_deg",
    "identify": "held_out_normalised",
    "diagnose": "held_out_after",
    "gains": "travel_rms_deg",
}
"""Column by which the worst cases of each work are found, if the campaign's file names none."""
DEFAULTS: Final[Settings] = {
    "rig": "makki2024",
    "model": "",
    "effects": [],
    "effect_files": [],
    "seed": 1,
    "plan": "identify",
    "validate": "step",
    "params": "",
    "draw": {},
    "threads": 1,
    "budget": 80,
}
"""Settings that a case may have, with their default values."""
_VALIDATION_SEED: Final = 500_000
"""Added to the seed for the flight that judges."""


def fly(settings: Settings) -> Result:
    """Fly a plan on a rig that may differ from its file by `settings`, and report how well it was tracked."""
    flown = _flown(settings, settings["plan"], 0)
    flight, summary = flown.flight, flown.summary
    return {
        "outcome": summary.outcome,
        "duration_s": float(flight.duration_s),
        **{f"{axis}_rms_deg": value for axis, value in _tracking_deg(flight).items()},
        "pitch_max_deg": float(np.degrees(np.abs(flight.pitch_rad)).max()),
        "voltage_max_V": float(flight.voltages_V.max()),
        **flown.drawn.row,
    }, {"notes": list(summary.notes)}


def identify(settings: Settings) -> Result:
    """Fit parameters to a flight of a rig that differs from its file by `settings`, and compare them with the
    true parameters.
    """
    from heli_lab.identify.run import identify as find

    flown = _flown(settings, settings["plan"], 0)
    nominal, true = flown.nominal, flown.drawn.rig
    other = _flown(settings, settings["validate"], _VALIDATION_SEED)
    # Its effects are those of the settings; the fit estimates their sizes.
    model = _model(settings, nominal, effects_with(nominal, settings["effects"], settings["effect_files"]))
    identification = find(
        model,
        nominal,
        [flown.flight],
        validation=[other.flight],
        labels=["fit"],
        validation_labels=["validation"],
        threads=settings["threads"],
    )
    off = {
        name: (value - true[name].value) / identification.fit.std[name]
        for name, value in identification.fit.values.items()
        if name in true and not name.startswith("offset_")
    }
    return {
        "outcome": _outcome(flown, other),
        "normalised": identification.training[0].normalised,
        "held_out_normalised": identification.validation[0].normalised,
        "within_2_std": float(np.mean([abs(z) < 2.0 for z in off.values()])) if off else None,
        "most_std_off": max((abs(z) for z in off.values()), default=None),
        "converged": identification.fit.converged,
        **flown.drawn.row,
    }, {"values": identification.fit.values, "std": identification.fit.std, "standard_errors_off": off}


def diagnose(settings: Settings) -> Result:
    """Hide the effects of the `settings` in two flights, and diagnose the flights. The row states whether the
    diagnosis names them.
    """
    from heli_lab.diagnose import diagnose as find
    from heli_lab.diagnose import to_json

    flown = _flown(settings, settings["plan"], 0)
    nominal = flown.nominal
    other = _flown(settings, settings["validate"], _VALIDATION_SEED)
    hidden = {effect.name for effect in parse_effects(settings["effects"], settings["effect_files"])}
    stated = effects_of(nominal, settings["effect_files"])
    known = tuple(effect for effect in stated if effect.name not in hidden)
    diagnosis = find(
        _model(settings, nominal, known),
        nominal,
        [flown.flight],
        [other.flight],
        kinds=catalogue(settings["effect_files"]),
        labels=["fit", "validation"],
        refits=settings["budget"],
        threads=settings["threads"],
    )
    numbers = to_json(diagnosis)
    named = {cause["effect"] for cause in numbers["causes"]}
    sure = {cause["effect"] for cause in numbers["causes"] if cause["confidence"] >= 0.9}
    gains = numbers["gain"]["axis"]
    return {
        "outcome": _outcome(flown, other),
        "verdict": numbers["verdict"],
        "causes": ", ".join(sorted(named)),
        "found": hidden <= named,
        "wrongly_sure": len(sure - hidden),
        "held_out_before": numbers["residual"]["normalised"]["held_out_before"],
        "held_out_after": numbers["residual"]["normalised"]["held_out_after"],
        **{f"{axis}_gain": gain["ratio"] for axis, gain in gains.items()},
        "complete": numbers["complete"],
        **flown.drawn.row,
    }, numbers


def gains(settings: Settings) -> Result:
    """Fly a demanding path with the board's parameters of the `settings`: a step of travel and back, then
    sines.
    """
    from dataclasses import asdict

    from heli_lab.tune.flights import try_gains

    nominal, draw = _draw(settings)
    true, effects = draw.rig, draw.effects
    model = _model(settings, nominal, parse_effects(effects, settings["effect_files"]))
    plant = Plant(model, true, settings["seed"])
    trial = try_gains(plant, _parameters(settings), "campaign", settings["seed"])
    metrics = asdict(trial.metrics)
    finite = {name: v if not isinstance(v, float) or np.isfinite(v) else None for name, v in metrics.items()}
    return {**finite, **draw.row}, {
        "effects": list(effects),
        "numbers": {name: n.value for name, n in true.items()},
    }


def drawn_row(settings: Settings) -> dict[str, Cell]:
    """Return the columns of the table for the drawn values of a case with these `settings`, without running
    the case.
    """
    return _draw(settings)[1].row


def _draw(settings: Settings) -> tuple[Rig, Drawn]:
    """The rig of the file, and what is drawn from it."""
    nominal = load_rig(settings["rig"])
    return nominal, drawn(nominal, settings["effects"], settings["draw"], settings["seed"])


@dataclass(frozen=True)
class _Flown:
    """The rig of the file, the rig that flew, the flight and its summary."""

    nominal: Rig
    drawn: Drawn
    flight: Flight
    summary: FlightSummary


def _outcome(*flights: _Flown) -> str:
    """Outcome of the first flight that did not end as it should; ``completed`` without one."""
    return next((flown.summary.outcome for flown in flights if not flown.summary.completed), "completed")


def _flown(settings: Settings, plan: str, more_seed: int) -> _Flown:
    nominal, draw = _draw(settings)
    model = _model(settings, nominal, effects_with(nominal, draw.effects, settings["effect_files"]))
    seed = settings["seed"] + more_seed
    with connected(world_of(Plant(model, draw.rig, seed), seed)) as heli:
        if parameters := _parameters(settings):
            heli.params.restore(parameters)
        return _Flown(nominal, draw, *fly_and_read(heli, plan))


def _parameters(settings: Settings) -> dict[str, float]:
    """Parameters of the board to fly with, by name."""
    return read_parameter_set(Path(settings["params"])).values if settings["params"] else {}


def _model(settings: Settings, rig: Rig, effects: Sequence[Effect]) -> Model:
    return model_named(settings["model"] or rig.model or MultibodyModel.name, tuple(effects))


def _tracking_deg(flight: Flight) -> dict[str, float]:
    """Root mean square error of elevation and travel against their setpoints in closed loop."""
    from heli_host.declaration import State

    setpoints = flight.setpoints_rad
    closed = None if flight.state is None else flight.state == State.CLOSED_LOOP
    if setpoints is None or closed is None or not closed.any():
        return {}
    off_deg = np.degrees(flight.angles_rad - setpoints)[closed]
    rms: Sequence[float] = np.sqrt(np.mean(off_deg**2, axis=0)).tolist()
    return {axis: value for axis, value in zip(AXES, rms, strict=True) if axis != "pitch"}

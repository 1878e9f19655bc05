"""Run the cases of a campaign: flights, fits, diagnoses and gain checks of simulated rigs, drawn at random.

Each function of `WORKS` takes the settings of a case, and returns its row and its details.
"""

from __future__ import annotations

import fnmatch
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from heli_host.board.parameters import read_parameter_set
from heli_host.data.flight import Flight
from heli_host.data.log.summary import FlightSummary
from heli_sim.model import MultibodyModel, model_named
from heli_sim.model.base import Effect, Model
from heli_sim.model.effect import AXES
from heli_sim.model.effects import catalogue, effects_of, effects_with, parse_effects
from heli_sim.model.plant import Plant
from heli_sim.rig import Rig, load_rig

from heli_lab.apps.campaign.cases import Cell
from heli_lab.errors import CampaignError
from heli_lab.simulated_board import connected, fly_and_read, world_of

TOLERANCES: Final = "tolerances"
PREFIX: Final = "drawn_"
"""Beginning of the names of the table's columns with drawn values."""
_FORMS: Final = ("share", "factor", "range")


@dataclass(frozen=True)
class RigDraw:
    """A rig and effects with parameters drawn at random from one seed."""

    rig: Rig  # The rig with the drawn parameters
    effects: tuple[str, ...]  # Effects as the command line spells them, each with its size
    numbers: Mapping[str, float]
    """The drawn values: by the rig file's name of a parameter, in its unit, or by the name of an effect."""

    @property
    def row(self) -> dict[str, Cell]:
        """Columns of the table: ``drawn_thrust_gain``, ``drawn_rotor_lag``."""
        return {f"{PREFIX}{name}": value for name, value in self.numbers.items()}


def draw_rig(
    rig: Rig, effects: Sequence[str], draw: str | Mapping[str, Mapping[str, Any]], seed: int
) -> RigDraw:
    """Draw parameters of a rig and sizes of effects at random."""
    random = np.random.default_rng([seed, 17])  # 17: a stream apart from the noise of the flight
    if isinstance(draw, str):
        if draw != TOLERANCES:
            raise CampaignError(f'unknown draw = "{draw}"', f'write draw = "{TOLERANCES}", or a table')
        values = _draw_within_tolerances(rig, random)
        return RigDraw(rig.replace(**values), tuple(effects), values)
    values, sizes = {}, {}
    effects_with_sizes = list(effects)
    for pattern, distribution in draw.items():
        check_distribution(pattern, distribution)
        names = [name for name in rig if fnmatch.fnmatchcase(name, pattern)]
        for name in names:
            values[name] = _draw_from_distribution(rig[name].value, distribution, random)
        if names:
            continue  # the pattern is that of parameters, not the name of an effect
        if pattern not in effects_with_sizes or "range" not in distribution:
            raise CampaignError(
                f"[draw] {pattern}: no number of rig {rig.name} and no effect of the case without a size",
                "correct the name; an effect needs a range",
            )
        # Rounded by the text of the effect; the table must state the rounded size.
        size = f"{_draw_from_distribution(0.0, distribution, random):.6g}"
        effects_with_sizes[effects_with_sizes.index(pattern)] = f"{pattern}={size}"
        sizes[pattern] = float(size)
    return RigDraw(rig.replace(**values), tuple(effects_with_sizes), {**values, **sizes})


def _draw_within_tolerances(rig: Rig, random: np.random.Generator) -> dict[str, float]:
    """Draw every parameter of a rig that has a tolerance from a normal distribution; return them by name."""
    values = {}
    for name, number in rig.items():
        if number.tolerance > 0.0:
            value = number.value + 0.5 * number.tolerance * float(random.standard_normal())
            values[name] = value if Rig.may_be_negative(name) else abs(value)
    return values


def check_distribution(name: str, distribution: object) -> None:
    """Check the `distribution` of the parameter `name` in a campaign file."""
    if (
        not isinstance(distribution, Mapping)
        or len(distribution) != 1
        or next(iter(distribution)) not in _FORMS
    ):
        raise CampaignError(
            f"[draw] {name}: it needs exactly one of {', '.join(_FORMS)}",
            "write, for example, { share = 0.2 }",
        )
    form, value = next(iter(distribution.items()))
    numbers = value if isinstance(value, list | tuple) else [value]
    # In Python, True is an int.
    valid = all(isinstance(number, int | float) and not isinstance(number, bool) for number in numbers)
    if form == "share":
        valid = valid and len(numbers) == 1 and 0.0 <= numbers[0] < 1.0
    elif form == "factor":
        valid = valid and len(numbers) == 1 and numbers[0] >= 1.0
    else:
        valid = valid and len(numbers) == 2 and numbers[0] <= numbers[1]
    if not valid:
        raise CampaignError(
            f"[draw] {name}: {form} = {value!r} is invalid",
            "give a share from 0 to 1, a factor of at least 1, or a range of two numbers",
        )


def _draw_from_distribution(
    value: float, distribution: Mapping[str, Any], random: np.random.Generator
) -> float:
    """Draw a number from a `distribution` about the nominal `value`."""
    if "share" in distribution:
        share = distribution["share"]
        return value * (1.0 + float(random.uniform(-share, share)))
    if "factor" in distribution:
        return value * float(distribution["factor"] ** random.uniform(-1.0, 1.0))
    low, high = distribution["range"]
    return float(random.uniform(low, high))


Settings = Mapping[str, Any]
Result = tuple[dict[str, Cell], Any]
"""Row of a case, by column, and further results that JSON can hold."""

WORKS: Final = {name: f"{__name__}:{name}" for name in ("fly", "identify", "diagnose", "gains")}
"""Functions that run cases, by their name in a campaign file."""
DEFAULT_RANKING: Final = {
    "fly": "travel_rms_deg",
    "identify": "held_out_normalised",
    "diagnose": "held_out_after",
    "gains": "travel_rms_deg",
}
"""Column whose largest values are the worst cases of each work, if the campaign file names none."""
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
_SURE_CONFIDENCE: Final = 0.9
"""Confidence from which on a cause that is not hidden counts as `wrongly_sure`."""
_VALIDATION_SEED: Final = 500_000
"""Added to the seed of a case for its validation flight."""


def fly(settings: Settings) -> Result:
    """Fly a plan on a rig that may differ from its rig file, and report how well the plan was tracked;
    `settings` are those of the case.
    """
    simulated = _fly_drawn_rig(settings, settings["plan"])
    flight, summary = simulated.flight, simulated.summary
    row = {
        "outcome": summary.outcome,
        "duration_s": float(flight.duration_s),
        **{f"{axis}_rms_deg": value for axis, value in _tracking_rms_deg(flight).items()},
        "pitch_max_deg": float(np.degrees(np.abs(flight.pitch_rad)).max()),
        "voltage_max_V": float(flight.voltages_V.max()),
        **simulated.drawn.row,
    }
    return row, {"notes": list(summary.notes)}


def identify(settings: Settings) -> Result:
    """Fit parameters to a flight of a rig that differs from its rig file, and compare them with the true
    parameters; `settings` are those of the case.
    """
    from heli_lab.fit.identification import identify as identify_rig

    training = _fly_drawn_rig(settings, settings["plan"])
    validation = _fly_drawn_rig(settings, settings["validate"], _VALIDATION_SEED)
    nominal, true = training.nominal, training.drawn.rig
    identification = identify_rig(
        # The fit estimates the sizes of the effects of the case.
        _chosen_model(
            settings, nominal, effects_with(nominal, settings["effects"], settings["effect_files"])
        ),
        nominal,
        [training.flight],
        validation=[validation.flight],
        labels=["fit"],
        validation_labels=["validation"],
        threads=settings["threads"],
    )
    fit = identification.fit
    # The zeros of the encoders differ from flight to flight, so they have no true value in the rig.
    errors_in_std = {
        name: (value - true[name].value) / fit.std[name]
        for name, value in fit.params.items()
        if name in true and not name.startswith("offset_")
    }
    sizes = [abs(error) for error in errors_in_std.values()]
    row = {
        "outcome": _first_failed_outcome(training, validation),
        "normalised": identification.training[0].normalised,
        "held_out_normalised": identification.validation[0].normalised,
        "within_2_std": float(np.mean([size < 2.0 for size in sizes])) if sizes else None,
        "most_std_off": max(sizes, default=None),
        "converged": identification.converged,
        **training.drawn.row,
    }
    return row, {"values": fit.params, "std": fit.std, "standard_errors_off": errors_in_std}


def diagnose(settings: Settings) -> Result:
    """Diagnose two flights in which the effects of the `settings` are hidden, and report whether the
    diagnosis finds these effects.
    """
    from heli_lab.explain import diagnose as diagnose_flights
    from heli_lab.report.diagnosis.serialize import to_json

    training = _fly_drawn_rig(settings, settings["plan"])
    validation = _fly_drawn_rig(settings, settings["validate"], _VALIDATION_SEED)
    nominal = training.nominal
    hidden = {effect.name for effect in parse_effects(settings["effects"], settings["effect_files"])}
    in_rig_file = effects_of(nominal, settings["effect_files"])
    known = tuple(effect for effect in in_rig_file if effect.name not in hidden)
    diagnosis = diagnose_flights(
        _chosen_model(settings, nominal, known),
        nominal,
        [training.flight],
        [validation.flight],
        kinds=catalogue(settings["effect_files"]),
        labels=["fit", "validation"],
        refits=settings["budget"],
        threads=settings["threads"],
    )
    report = to_json(diagnosis)
    diagnosed = {cause["effect"] for cause in report["causes"]}
    confident = {cause["effect"] for cause in report["causes"] if cause["confidence"] >= _SURE_CONFIDENCE}
    normalised = report["residual"]["normalised"]
    row = {
        "outcome": _first_failed_outcome(training, validation),
        "verdict": report["verdict"],
        "causes": ", ".join(sorted(diagnosed)),
        "found": hidden <= diagnosed,
        "wrongly_sure": len(confident - hidden),
        "held_out_before": normalised["held_out_before"],
        "held_out_after": normalised["held_out_after"],
        **{f"{axis}_gain": gain["ratio"] for axis, gain in report["gain"]["axis"].items()},
        "complete": report["complete"],
        **training.drawn.row,
    }
    return row, report


def gains(settings: Settings) -> Result:
    """Test the board's parameters of the `settings` on a demanding flight: a step of travel, back, then
    sines.
    """
    from dataclasses import asdict

    from heli_lab.control.tune.trial import try_gains

    nominal, drawn = _nominal_and_drawn_rig(settings)
    model = _chosen_model(settings, nominal, parse_effects(drawn.effects, settings["effect_files"]))
    plant = Plant(model, drawn.rig, settings["seed"])
    trial = try_gains(plant, _board_parameters(settings), "campaign", settings["seed"])
    metrics = {
        name: None if isinstance(value, float) and not np.isfinite(value) else value
        for name, value in asdict(trial.metrics).items()
    }
    detail = {
        "effects": list(drawn.effects),
        "numbers": {name: number.value for name, number in drawn.rig.items()},
    }
    return {**metrics, **drawn.row}, detail


def drawn_row(settings: Settings) -> dict[str, Cell]:
    """Return the drawn values of a case with these `settings` as columns of the table, without running it."""
    _, drawn = _nominal_and_drawn_rig(settings)
    return drawn.row


def _nominal_and_drawn_rig(settings: Settings) -> tuple[Rig, RigDraw]:
    """Return the rig of the rig file, and the rig with the drawn parameters of a case."""
    nominal = load_rig(settings["rig"])
    return nominal, draw_rig(nominal, settings["effects"], settings["draw"], settings["seed"])


@dataclass(frozen=True)
class _SimulatedFlight:
    """A flight of a simulated rig."""

    nominal: Rig  # The rig of the file
    drawn: RigDraw  # The rig that flew, and its effects
    flight: Flight  # Log of the flight
    summary: FlightSummary  # Outcome of the flight


def _first_failed_outcome(*flights: _SimulatedFlight) -> str:
    """Return the outcome of the first flight that was not completed; otherwise ``completed``."""
    return next((flight.summary.outcome for flight in flights if not flight.summary.completed), "completed")


def _fly_drawn_rig(settings: Settings, plan: str, seed_offset: int = 0) -> _SimulatedFlight:
    """Fly a plan on the simulated rig of a case."""
    nominal, drawn = _nominal_and_drawn_rig(settings)
    model = _chosen_model(settings, nominal, effects_with(nominal, drawn.effects, settings["effect_files"]))
    seed = settings["seed"] + seed_offset
    with connected(world_of(Plant(model, drawn.rig, seed), seed)) as heli:
        if parameters := _board_parameters(settings):
            heli.params.restore(parameters)
        return _SimulatedFlight(nominal, drawn, *fly_and_read(heli, plan))


def _board_parameters(settings: Settings) -> dict[str, float]:
    """Read the board's parameters of a case, by name; empty if its settings name no file."""
    return read_parameter_set(Path(settings["params"])).values if settings["params"] else {}


def _chosen_model(settings: Settings, rig: Rig, effects: tuple[Effect, ...]) -> Model:
    """Return the model that the settings name, or otherwise that of the `rig`, with these `effects`."""
    return model_named(settings["model"] or rig.model or MultibodyModel.name, effects)


def _tracking_rms_deg(flight: Flight) -> dict[str, float]:
    """Compute the RMS tracking error of elevation and travel in closed loop [deg], by axis; empty for a
    flight without setpoints.
    """
    from heli_host.declaration import State

    setpoints_rad = flight.setpoints_rad
    if setpoints_rad is None or flight.state is None:
        return {}
    in_closed_loop = flight.state == State.CLOSED_LOOP
    if not in_closed_loop.any():
        return {}
    error_deg = np.degrees(flight.angles_rad - setpoints_rad)[in_closed_loop]
    rms_deg: Sequence[float] = np.sqrt(np.mean(error_deg**2, axis=0)).tolist()
    return {axis: value for axis, value in zip(AXES, rms_deg, strict=True) if axis != "pitch"}

"""What the page knows of rigs, effects, plans and the link, as one JSON value written at build time."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from typing import Any

from heli_host.board.law_program import LawProgram
from heli_host.data.files import LOG_WRITER
from heli_host.data.log import schema
from heli_host.data.log.blind import Truth
from heli_host.declaration import CHANNELS, FAULTS, LINK_VERSION, PARAMS
from heli_host.fly.plan import Plan
from heli_host.link.installation import installed_version
from heli_host.ui.page.source import channel_rows, parameter_rows, state_rows
from heli_sim.errors import SimError
from heli_sim.model import model_named
from heli_sim.model.base import Model
from heli_sim.model.effect import Effect
from heli_sim.model.effects.catalogue import catalogue
from heli_sim.model.effects.spec import EffectSpec
from heli_sim.model.multibody import MultibodyModel
from heli_sim.model.plant import LIMITS, extras, step_function
from heli_sim.rig import Rig
from heli_sim.rig.board import in_simulation
from heli_sim.rig.rig import count_rad, directions
from heli_sim.sil.world import saved

from heli_web.plant import plant_module

_ERASED = b"\xff" * 2048
RIGS = ("makki2024", "makki2024-identified", "quanser-course")


def plant_facts(model: Model) -> dict[str, Any]:
    """Return a plant: its module, the names of its parameters, and its states beyond those of the model."""
    added = extras(model)
    return {
        "module": base64.b64encode(plant_module(step_function(model))).decode(),
        "parameters": [*model.parameter_names, *LIMITS],
        "states": len(model.states) + len(added.states),
        "random_state": len(model.states) + added.timed if added.random else -1,
        "delay": model.delay,
    }


def rig_facts(rig: Rig) -> dict[str, Any]:
    """Return a rig's numbers, and the flash of a board that suits it."""
    model = model_named(rig.model or MultibodyModel.name)
    names, settings = [*model.parameter_names, *LIMITS], in_simulation(rig)
    values = [*model.parameter_values(rig), *(rig[name].value for name in LIMITS)]
    return {
        "name": rig.name,
        "values": dict(zip(names, (float(value) for value in values), strict=True)),
        "drawing": {name: rig[name].value for name in rig},
        "supply_V": rig["supply"].value,
        "dead_band": rig["driver_dead_band"].value,
        "counts_per_rad": (directions(rig) / count_rad(rig)).tolist(),
        "flash": base64.b64encode(saved(settings) if settings else _ERASED).decode(),
    }


def effect_facts(kind: EffectSpec) -> dict[str, Any] | None:
    """Return an effect with its plant and its parameters; None if it suits no model of the page."""
    try:
        model = MultibodyModel((kind.make(kind.typical),))
        plant = plant_facts(model)
    except SimError:
        return None
    return {
        "id": kind.id,
        "sentence": kind.describe(kind.typical),
        "parameters": [
            _parameter_facts(kind, parameter) | {"symbol": quantity.name}
            for parameter, quantity in zip(kind.numbers, model.effects[0].parameters, strict=True)
        ],
        "override": dict(kind.override),
        "plant": plant,
    }


def _parameter_facts(kind: EffectSpec, parameter: Any) -> dict[str, Any]:
    """Return a parameter with the range of its slider: three typical sizes, within what the prior permits."""
    reach = 3.0 * abs(parameter.typical) or 1.0
    prior = parameter.prior
    is_signed = parameter.size or parameter.typical < 0
    low, high = -reach if is_signed else 0.0, reach
    if prior is not None:
        low, high = max(low, prior.low), min(high, prior.high)
    return {
        "name": f"{kind.id}.{parameter.name}",
        "unit": parameter.unit,
        "meaning": parameter.meaning,
        "typical": parameter.typical,
        "neutral": parameter.neutral_value,
        "low": low,
        "high": high,
    }


def log_facts() -> dict[str, Any]:
    """Return the layout of a log: schemas, channels, and the fields of a tick."""
    # Channel and axis of each column of a tick.
    columns: dict[str, tuple[int | None, int | None]] = {
        spec.field: (index, None) for index, spec in enumerate(CHANNELS)
    }
    columns |= {
        spec.column: (index, int(spec.axis)) for index, spec in enumerate(CHANNELS) if spec.axis is not None
    }
    fields: Mapping[str, Any] = schema.TICK_LAYOUT.dtype.fields or {}
    return {
        "library": f"{LOG_WRITER} {LINK_VERSION})",
        "schemas": [
            {"name": schema.TICK_SCHEMA_NAME, "encoding": "ros2msg", "data": schema.TICK_SCHEMA},
            {"name": schema.EVENT_SCHEMA_NAME, "encoding": "jsonschema", "data": schema.EVENT_SCHEMA},
            {"name": schema.LINK_SCHEMA_NAME, "encoding": "jsonschema", "data": schema.LINK_SCHEMA},
        ],
        "channels": [
            {"topic": schema.TICK_TOPIC, "encoding": "cdr"},
            {"topic": schema.EVENT_TOPIC, "encoding": "json"},
            {"topic": schema.LINK_TOPIC, "encoding": "json"},
        ],
        "fields": [
            {
                "name": name,
                "code": kind.str[1:],
                "channel": columns.get(name, (None, None))[0],
                "axis": columns.get(name, (None, None))[1],
            }
            for name, (kind, *_) in fields.items()
        ],
    }


def combined_facts(effects: tuple[Effect, ...], rig: Rig) -> dict[str, Any]:
    """Return several effects with given values as one effect of the page."""
    model, kinds = MultibodyModel(effects), catalogue()
    values = dict(zip(model.parameter_names, model.parameter_values(rig), strict=True))
    name = "+".join(effect.name for effect in effects)
    parameters = []
    for effect in effects:
        kind = kinds[effect.name]
        for parameter, quantity in zip(kind.numbers, effect.parameters, strict=True):
            value = float(values[quantity.name])
            facts = _parameter_facts(kind, parameter)
            low, high = min(facts["low"], value), max(facts["high"], value)
            parameters.append(
                facts
                | {
                    "name": f"{name}.{parameter.name if len(effects) == 1 else facts['name']}",
                    "low": low,
                    "high": high,
                }
                | {"symbol": quantity.name, "typical": value}
            )
    return {
        "id": name,
        "sentence": "as the page was made",
        "parameters": parameters,
        "override": {},
        "plant": plant_facts(model),
    }


def law_facts(laws: Sequence[LawProgram]) -> list[dict[str, Any]]:
    """Return what the page uploads of each control law."""
    return [
        {
            "name": law.name,
            "hash": law.hash,
            "words": list(law.words),
            "parameters": dict(law.parameters),
            "signals": list(law.signal_names),
        }
        for law in laws
    ]


def page_facts(
    plans: Sequence[Plan],
    tables: Mapping[str, Mapping[str, Any]],
    rigs: Sequence[Rig],
    laws: Sequence[LawProgram] = (),
) -> dict[str, Any]:
    """Return all facts of a page with these plans, rigs and control laws; `tables` are the plans' parsed TOML
    tables.
    """
    values = {spec.name: spec.default for spec in PARAMS}
    effects = [facts for kind in catalogue().values() if (facts := effect_facts(kind)) is not None]
    return {
        "version": installed_version(),
        "hello": {
            "mode": "live",
            "kind": "simulation",
            "tick_s": 0.001,
            "channels": channel_rows(values),
            "states": state_rows(),
            "parameters": parameter_rows(),
            "plans": [{"name": plan.name, "title": plan.title} for plan in plans],
            "laws": [
                {"name": law.name, "rate_Hz": law.rate_Hz, "signals": list(law.signal_names)} for law in laws
            ],
        },
        "faults": {
            spec.code: {
                "name": spec.name,
                "meaning": spec.meaning,
                "remedy": spec.remedy,
                "parameter": spec.parameter,
            }
            for spec in FAULTS
        },
        "log": log_facts(),
        "plans": [
            {"name": plan.name, "title": plan.title, "text": plan.text, "table": tables[plan.name]}
            for plan in plans
        ],
        "laws": law_facts(laws),
        "rigs": [rig_facts(rig) for rig in rigs],
        "plants": {"": plant_facts(MultibodyModel())},
        "effects": effects,
    }


def hidden_facts(effects: tuple[Effect, ...], rig: Rig, truth: Truth) -> dict[str, Any]:
    """Return the plant of a puzzle, whose hidden parameters have numbers as names, and its seal."""
    model: Model = model_named(rig.model or "multibody", effects)
    plant = plant_facts(model)
    values = dict(zip(model.parameter_names, model.parameter_values(rig), strict=True))
    hidden = [quantity.name for effect in model.effects for quantity in effect.parameters]
    plain = {name: f"number {index}" for index, name in enumerate(hidden, 1)}
    plant["parameters"] = [plain.get(name, name) for name in plant["parameters"]]
    plant["delay"] = plain.get(plant["delay"], "")
    parameters = [
        {"name": plain[name], "symbol": plain[name], "typical": float(values[name])} for name in hidden
    ]
    return {"sealed": truth.digest, "effect": "hidden", "hidden": {"plant": plant, "parameters": parameters}}

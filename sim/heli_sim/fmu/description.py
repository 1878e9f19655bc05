"""The model description of an FMU: its variables and capabilities, in the standard's XML."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final
from xml.etree import ElementTree

from heli_sim.model.plant import LIMITS, Plant, STEP_s
from heli_sim.rig import RIG_QUANTITIES

# As sources/fmi3.c has them.
_INPUTS: Final = 1
_OUTPUTS: Final = 3
_INDICATORS: Final = 6
_CHANCE: Final = 12
_STATES: Final = 100
_RATES: Final = 10_000
_PARAMETERS: Final = 20_000

_AXES: Final = ("elevation", "pitch", "travel")
_BASE_UNITS: Final[dict[str, dict[str, str]]] = {
    "rad": {"rad": "1"},
    "rad/s": {"rad": "1", "s": "-1"},
    "rad/s2": {"rad": "1", "s": "-2"},
    "s": {"s": "1"},
    "1/s": {"s": "-1"},
    "m": {"m": "1"},
    "kg": {"kg": "1"},
    "V": {"kg": "1", "m": "2", "s": "-3", "A": "-1"},
    "N": {"kg": "1", "m": "1", "s": "-2"},
    "N/s": {"kg": "1", "m": "1", "s": "-3"},
    "N m": {"kg": "1", "m": "2", "s": "-2"},
    "deg": {"rad": "1", "factor": "0.017453292519943295"},
}
"""Units in terms of the SI's; those not here have a name only."""


@dataclass(frozen=True)
class Variable:
    """A variable of the description; all are 64-bit floats."""

    name: str  # Its name, structured by dots
    reference: int  # Value reference
    unit: str  # As rigs spell it; ``1`` for none
    meaning: str  # One line
    causality: str
    """causality, variability, initial: As the standard has them; empty for what it takes by itself."""
    variability: str
    initial: str = ""
    start: float | None = None  # Value to begin with
    derivative_of: int = 0  # Value reference of the state whose rate it is; 0 for none


def variables(plant: Plant) -> list[Variable]:
    """List the variables of a plant that an importer sees: time, voltages, measured angles, states, rates,
    parameters.
    """
    return list(_variables_in_order(plant))


def _variables_in_order(plant: Plant) -> Iterator[Variable]:
    """Yield the variables of an FMU in the order of its reference: time, inputs, outputs, distances to the
    stops, states, their rates, and parameters.
    """
    yield Variable("time", 0, "s", "simulated time", causality="independent", variability="continuous")
    for index, quantity in enumerate(plant.model.inputs):
        yield Variable(
            quantity.name, _INPUTS + index, quantity.unit, quantity.meaning,
            causality="input", variability="continuous", start=0.0,
        )  # fmt: skip
    for index, axis in enumerate(_AXES):
        yield Variable(
            f"{axis}_rad", _OUTPUTS + index, "rad", f"{axis} as an ideal encoder measures it",
            causality="output", variability="continuous", initial="calculated",
        )  # fmt: skip
    gaps = [(axis, side) for side in ("lower", "upper") for axis in _AXES]
    for index, (axis, side) in enumerate(gaps):
        yield Variable(
            f"gap.{axis}_{side}_rad", _INDICATORS + index, "rad", f"way to the {side} stop of {axis}",
            causality="local", variability="continuous", initial="calculated",
        )  # fmt: skip
    start = plant.rest_state()
    count = len(plant.model.states)
    if plant.extras.random:
        chance = float(start[count + plant.extras.timed])
        yield Variable(
            "chance", _CHANCE, "1", "state of the random generator, a whole number from 1",
            causality="parameter", variability="fixed", initial="exact", start=chance,
        )  # fmt: skip
    for index, state in enumerate(plant.model.states):
        yield Variable(
            f"state.{state.name}", _STATES + index, state.unit, state.meaning,
            causality="local", variability="continuous", initial="exact", start=float(start[index]),
        )  # fmt: skip
    for index, state in enumerate(plant.model.states):
        unit = "rad/s2" if state.unit == "rad/s" else "1" if state.unit == "1" else f"{state.unit}/s"
        yield Variable(
            f"der(state.{state.name})", _RATES + index, unit, f"rate of state.{state.name}",
            causality="local", variability="continuous", initial="calculated", derivative_of=_STATES + index,
        )  # fmt: skip
    known = {quantity.name: quantity for quantity in RIG_QUANTITIES}
    parameters = [*plant.model.parameters, *(known[name] for name in LIMITS)]
    seen: set[str] = set()
    for index, quantity in enumerate(parameters):
        # The number of delayed voltages, and so the size of the state, follows from the delay.
        is_constant = quantity.name == plant.model.delay
        # A limit that is a parameter of the equations, too, is the parameter of the stop.
        name = f"rig.{quantity.name}" if quantity.name not in seen else f"rig.stop.{quantity.name}"
        seen.add(quantity.name)
        yield Variable(
            name, _PARAMETERS + index, quantity.unit, quantity.meaning,
            causality="local" if is_constant else "parameter",
            variability="constant" if is_constant else "tunable",
            initial="exact", start=float(plant.parameters[index]),
        )  # fmt: skip


def describe(plant: Plant, identifier: str, token: str) -> bytes:
    """Write ``modelDescription.xml``."""
    all_variables = variables(plant)
    root = ElementTree.Element(
        "fmiModelDescription",
        fmiVersion="3.0",
        modelName=f"{plant.rig.name} ({plant.model.name})",
        instantiationToken=token,
        description=plant.rig.description,
        generationTool="heli_sim",
        variableNamingConvention="structured",
    )
    capabilities = {
        "modelIdentifier": identifier,
        "canGetAndSetFMUState": "true",
        "canSerializeFMUState": "true",
    }
    ElementTree.SubElement(root, "ModelExchange", capabilities)
    ElementTree.SubElement(
        root,
        "CoSimulation",
        {
            **capabilities,
            "canHandleVariableCommunicationStepSize": "true",
            "fixedInternalStepSize": repr(STEP_s),
        },
    )
    _add_units(root, all_variables)
    ElementTree.SubElement(root, "DefaultExperiment", startTime="0.0", stopTime="60.0", stepSize=repr(STEP_s))
    model_variables = ElementTree.SubElement(root, "ModelVariables")
    for variable in all_variables:
        ElementTree.SubElement(model_variables, "Float64", _attributes_of_variable(variable))
    structure = ElementTree.SubElement(root, "ModelStructure")
    outputs = [variable.reference for variable in all_variables if variable.causality == "output"]
    rates = [variable.reference for variable in all_variables if variable.derivative_of]
    indicators = [variable.reference for variable in all_variables if variable.name.startswith("gap.")]
    for kind, references in (
        ("Output", outputs),
        ("ContinuousStateDerivative", rates),
        ("InitialUnknown", sorted([*outputs, *rates])),
        ("EventIndicator", indicators),
    ):
        for reference in references:
            ElementTree.SubElement(structure, kind, valueReference=str(reference))
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True))


def _attributes_of_variable(variable: Variable) -> dict[str, str]:
    """Return the attributes of a variable in modelDescription.xml."""
    attributes = {
        "name": variable.name,
        "valueReference": str(variable.reference),
        "description": variable.meaning,
        "causality": variable.causality,
        "variability": variable.variability,
    }
    if variable.initial:
        attributes["initial"] = variable.initial
    if variable.unit != "1":
        attributes["unit"] = variable.unit
    if variable.start is not None:
        attributes["start"] = repr(variable.start)
    if variable.derivative_of:
        attributes["derivative"] = str(variable.derivative_of)
    return attributes


def _add_units(root: ElementTree.Element, listed: list[Variable]) -> None:
    """Add the units of all variables, with their factors to SI units."""
    definitions = ElementTree.SubElement(root, "UnitDefinitions")
    for unit in sorted({variable.unit for variable in listed} - {"1"}):
        entry = ElementTree.SubElement(definitions, "Unit", name=unit)
        if unit in _BASE_UNITS:
            ElementTree.SubElement(entry, "BaseUnit", _BASE_UNITS[unit])

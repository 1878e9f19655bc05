"""Write the equations of a plant as the C functions that an FMU (a model for co-simulation) calls."""

from __future__ import annotations

from dataclasses import dataclass

import casadi as ca

from heli_sim.model.effect import Effect
from heli_sim.plant import Plant, delayed_volts_V, end_of_step


@dataclass(frozen=True)
class Generated:
    """Generated C files of one plant."""

    files: dict[str, str]  # Contents by file name
    has_millisecond_events: bool
    """Whether the plant changes discretely every millisecond: by delayed voltages, resets or random inputs.
    """


def generate(plant: Plant, token: str) -> Generated:
    """Write the C files with a plant's equations and parameters."""
    model, extras = plant.model, plant.extras
    delay_ticks = sum(state.name.startswith("front_V_") for state in extras.states)
    x, u = ca.SX.sym("state", len(model.states)), ca.SX.sym("acting_V", 2)
    p, t, generator_state = (
        ca.SX.sym("parameters", len(plant.parameters)),
        ca.SX.sym("t"),
        ca.SX.sym("chance"),
    )
    p_model = p[: len(model.parameters)]
    after, _, next_generator_state = end_of_step(model, x, u, p, t, generator_state, ca.SX.zeros(3))
    functions = [
        plant.function,
        _dense_function("model_rates", [x, u, p, t], [model.dynamics(x, u, p_model, t)]),
        _dense_function("model_measured", [x, u, p, t], [model.measurement(x, u, p_model, t)]),
        _dense_function("model_end_of_step", [x, u, p, t, generator_state], [after, next_generator_state]),
    ]
    if delay_ticks:
        past_V = ca.SX.sym("past_V", 2 * delay_ticks)
        functions.append(
            _dense_function(
                "model_late_volts", [u, past_V], [delayed_volts_V(u, past_V, plant.extras.delay_s)]
            )
        )
    generator = ca.CodeGenerator("model", {"with_header": False})
    for function in functions:
        generator.add(function)
    has_millisecond_events = (
        bool(delay_ticks) or extras.random or any(_has_reset(effect) for effect in model.effects)
    )
    numbers = {
        "STATES": len(model.states),
        "WHOLE": len(plant.rest_state()),
        "PARAMETERS": len(plant.parameters),
        "LIMITS": len(model.parameters),
        "TIMED": int(extras.timed),
        "RANDOM": int(extras.random),
        "LATE": delay_ticks,
        "SAMPLED": int(has_millisecond_events),
        "INPUTS": max(function.n_in() for function in functions),
        "OUTPUTS": max(function.n_out() for function in functions),
        "WORK_ARGUMENTS": max(function.sz_arg() for function in functions) + 1,
        "WORK_RESULTS": max(function.sz_res() for function in functions) + 1,
        "WORK_INTEGERS": max(function.sz_iw() for function in functions) + 1,
        "WORK_NUMBERS": max(function.sz_w() for function in functions) + 1,
    }
    lines = ["#ifndef MODEL_NUMBERS_H", "#define MODEL_NUMBERS_H"]
    lines += [f"#define MODEL_{name} {number}" for name, number in numbers.items()]
    lines += [f'#define MODEL_TOKEN "{token}"']
    lines += ["extern const double model_start_state[];", "extern const double model_start_parameters[];"]
    start_values = (
        '#include "model_numbers.h"\n'
        f"const double model_start_state[] = {{{_c_numbers(plant.rest_state().tolist())}}};\n"
        f"const double model_start_parameters[] = {{{_c_numbers(plant.parameters.tolist())}}};\n"
    )
    return Generated(
        {
            "model.c": generator.dump(),
            "model.h": _c_header(functions),
            "model_numbers.h": "\n".join([*lines, "#endif", ""]),
            "model_start.c": start_values,
        },
        has_millisecond_events,
    )


def _c_header(functions: list[ca.Function]) -> str:
    """Return the C header with the prototypes of the generated functions."""
    prototypes = [
        f"int {function.name()}(const double** arg, double** res, long long int* iw, double* w, int mem);"
        for function in functions
    ]
    return "\n".join(["#ifndef MODEL_H", "#define MODEL_H", *prototypes, "#endif", ""])


def _dense_function(name: str, inputs: list[ca.SX], results: list[ca.SX]) -> ca.Function:
    return ca.Function(name, inputs, ca.cse([ca.densify(result) for result in results]))


def _has_reset(effect: Effect) -> bool:
    """Whether an effect resets a state at the end of a step."""
    return type(effect).reset_map is not Effect.reset_map


def _c_numbers(numbers: list[float]) -> str:
    """Return numbers as the initialiser of a C array."""
    return ", ".join(repr(float(number)) for number in numbers)

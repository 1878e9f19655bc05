"""An FMU of a plant: its equations as C, sources, and the binary for this machine, in one zip file."""

from __future__ import annotations

import hashlib
import platform
import re
import subprocess
import sys
import tempfile
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

import casadi as ca
from heli_host.data.files import WRITER, replacing

from heli_sim.errors import PlantError
from heli_sim.evaluate.compiled import FLAGS, LIBRARIES, compiler
from heli_sim.fmu.description import describe, variables
from heli_sim.model.effect import Effect
from heli_sim.model.plant import Plant, delayed_volts_V, end_of_step


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
    x, u = ca.SX.sym("state", len(model.states)), ca.SX.sym("acting_V", 2)
    p, t, generator_state = (
        ca.SX.sym("parameters", len(plant.parameters)),
        ca.SX.sym("t"),
        ca.SX.sym("chance"),
    )
    p_model = p[: len(model.parameters)]
    no_locks = ca.SX.zeros(3)
    after, _, next_generator_state = end_of_step(model, x, u, p, t, generator_state, no_locks)
    functions = [
        plant.function,
        _dense_function("model_rates", [x, u, p, t], [model.dynamics(x, u, p_model, t)]),
        _dense_function("model_measured", [x, u, p, t], [model.measurement(x, u, p_model, t)]),
        _dense_function("model_end_of_step", [x, u, p, t, generator_state], [after, next_generator_state]),
    ]
    if extras.delay_ticks:
        past_V = ca.SX.sym("past_V", 2 * extras.delay_ticks)
        functions.append(
            _dense_function("model_late_volts", [u, past_V], [delayed_volts_V(u, past_V, extras.delay_s)])
        )
    generator = ca.CodeGenerator("model", {"with_header": False})
    for function in functions:
        generator.add(function)
    # An importer must then stop after each millisecond.
    has_millisecond_events = (
        extras.delay_ticks > 0 or extras.random or any(_has_reset(effect) for effect in model.effects)
    )
    numbers = {
        "STATES": len(model.states),
        "WHOLE": len(plant.rest_state()),
        "PARAMETERS": len(plant.parameters),
        "LIMITS": len(model.parameters),
        "TIMED": int(extras.timed),
        "RANDOM": int(extras.random),
        "LATE": extras.delay_ticks,
        "SAMPLED": int(has_millisecond_events),
        "INPUTS": max(function.n_in() for function in functions),
        "OUTPUTS": max(function.n_out() for function in functions),
        # One more than needed, because C has no arrays of length 0.
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


_SOURCES: Final = Path(__file__).parent / "sources"
_HIDDEN: Final = () if sys.platform == "win32" else ("-fvisibility=hidden",)
_MACHINES: Final = {"amd64": "x86_64", "arm64": "aarch64"}
_SYSTEMS: Final = {"linux": ("linux", ".so"), "darwin": ("darwin", ".dylib"), "win32": ("windows", ".dll")}
_DATE: Final = (2024, 1, 1, 0, 0, 0)
"""Date of all entries, so that the same plant gives the same bytes."""


def write_fmu(plant: Plant, path: str | Path) -> str:
    """Write a functional mock-up unit: FMI 3.0, model exchange and co-simulation, with its sources.

    Parameters
    ----------
    plant : Plant
        A rig with its model and effects.
    path : str or Path
        ``.fmu`` file to write.

    Returns
    -------
    str
        System for which the file holds a binary, such as ``x86_64-linux``; empty without a C compiler: an
        importer then has to compile the sources.

    Raises
    ------
    PlantError
        The compiler fails, or the file cannot be written.
    """
    identifier = re.sub(r"\W", "_", f"heli_{plant.rig.name}", flags=re.ASCII)
    token = _instantiation_token(plant)
    files = {"modelDescription.xml": describe(plant, identifier, token)}
    sources = {name: text.encode() for name, text in generate(plant, token).files.items()}
    sources |= {path.name: path.read_bytes() for path in sorted(_SOURCES.glob("*.[ch]"))}
    compiled = sorted(name for name in sources if name.endswith(".c"))
    files |= {f"sources/{name}": data for name, data in sorted(sources.items())}
    files["sources/buildDescription.xml"] = _build_description(identifier, compiled)
    machine = _MACHINES.get(platform.machine().lower(), platform.machine().lower())
    system, suffix = _SYSTEMS.get(sys.platform, ("linux", ".so"))
    binary = _compile_library(sources, compiled)
    if binary is not None:
        files[f"binaries/{machine}-{system}/{identifier}{suffix}"] = binary
    try:
        with replacing(path) as unfinished, zipfile.ZipFile(unfinished, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.comment = WRITER.encode()
            for name, data in files.items():
                archive.writestr(zipfile.ZipInfo(name, _DATE), data, zipfile.ZIP_DEFLATED)
    except OSError as error:
        raise PlantError(
            f"cannot write {path}: {error.strerror or error}", "choose another folder"
        ) from error
    return f"{machine}-{system}" if binary is not None else ""


def _instantiation_token(plant: Plant) -> str:
    """Identify this FMU: a digest of its variables and equations."""
    text = "\n".join(
        [*(repr(variable) for variable in variables(plant)), *generate(plant, "").files.values()]
    )
    return "{" + hashlib.sha256(text.encode()).hexdigest()[:32] + "}"


def _build_description(identifier: str, compiled: list[str]) -> bytes:
    """Return buildDescription.xml, which names the C sources to compile."""
    root = ElementTree.Element("fmiBuildDescription", fmiVersion="3.0")
    configuration = ElementTree.SubElement(root, "BuildConfiguration", modelIdentifier=identifier)
    group = ElementTree.SubElement(configuration, "SourceFileSet", language="C99")
    for name in compiled:
        ElementTree.SubElement(group, "SourceFile", name=name)
    ElementTree.indent(root)
    return bytes(ElementTree.tostring(root, encoding="utf-8", xml_declaration=True))


def _compile_library(sources: dict[str, bytes], compiled: list[str]) -> bytes | None:
    """Compile the C sources of an FMU, and return the shared library; None without a compiler."""
    cc = compiler()
    if cc is None:
        return None
    with tempfile.TemporaryDirectory(prefix="heli-fmu-") as folder:
        for name, data in sources.items():
            (Path(folder) / name).write_bytes(data)
        # As the plant's own step is compiled, so that both give the same numbers.
        command = [cc, "-std=c99", *FLAGS, *_HIDDEN, "-o", "model.bin", *compiled, *LIBRARIES]
        process = subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)
        if process.returncode != 0:
            reason = (process.stderr.strip().splitlines() or ["no message"])[0]
            raise PlantError(f"{cc} cannot compile the FMU: {reason}", "set CC to a working C compiler")
        return (Path(folder) / "model.bin").read_bytes()

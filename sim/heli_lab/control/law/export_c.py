"""Export a control law as one file of C."""

from __future__ import annotations

import tempfile
from pathlib import Path

import casadi as ca
from heli_host.declaration import LAW_INPUTS

from heli_lab.control.law.law import Law


def c_source(law: Law) -> str:
    """Return the law as C: CasADi's function ``law`` in single precision, with a comment on its arguments."""
    lines = [
        f"/* {law.name}: a control law, called {law.rate_Hz:g} times a second.",
        "   int law(const float** arg, float** res, long long* iw, float* w, int mem);",
        f"   arg[0], inputs: {', '.join(LAW_INPUTS)}",
        f"   arg[1], states, first values: {_names_and_values(law.states)}",
        f"   arg[2], parameters: {_names_and_values(law.parameters)}",
        f"   res[0]: front_V, back_V, three setpoints in rad{''.join(f', {name}' for name in law.signals)}",
        "   res[1]: new states */",
    ]
    generator = ca.CodeGenerator("law.c", {"casadi_real": "float", "with_header": False})
    generator.add(law.evaluated)
    with tempfile.TemporaryDirectory() as folder:
        generator.generate(f"{folder}/")
        body = (Path(folder) / "law.c").read_text(encoding="utf-8")
    return "\n".join(lines) + "\n" + body


def _names_and_values(values: dict[str, float]) -> str:
    """Write named values into one line of a comment."""
    return ", ".join(f"{name} = {value:g}" for name, value in values.items()) or "none"

"""An FMU of a plant: description, sources, and the binary for this machine, in one zip file."""

from __future__ import annotations

import hashlib
import platform
import re
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path
from typing import Final
from xml.etree import ElementTree

from heli_host.data.files import WRITER, replacing

from heli_sim.compiled import FLAGS, LIBRARIES, compiler
from heli_sim.errors import PlantError
from heli_sim.fmu.description import describe, variables
from heli_sim.fmu.functions import generate
from heli_sim.plant import Plant

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
        For which system it holds a binary, such as ``x86_64-linux``; empty without a C compiler: an importer
        then has to compile the sources.

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

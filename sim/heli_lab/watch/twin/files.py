"""Reads the rig, model and calibration of a twin from a rig's name, a rig file, or a twin file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from heli_host.data.files import TOML_BYTES, decode_text, parse_toml, read_file
from heli_host.errors import file_remedy
from heli_sim.model.base import Model
from heli_sim.model.effects import effects_of
from heli_sim.model.named import model_named
from heli_sim.rig import Rig, load_rig

from heli_lab.errors import TwinError
from heli_lab.watch.twin.calibration import DEFAULT_DISTURBANCES, Calibration, parse_calibration
from heli_lab.watch.twin.tail import IDEAL

DEFAULT_CALIBRATION: Final = Calibration(DEFAULT_DISTURBANCES, IDEAL, "a quiet room")
"""Calibration of a rig without a twin file: the tail is that of simulated flights of the rig makki2024 with
these disturbances."""


@dataclass(frozen=True)
class TwinRig:
    """A rig, its model and the calibration: everything that a twin needs."""

    rig: Rig  # Parameters of the rig
    model: Model  # Equations of motion with the effects that the rig file states
    calibration: Calibration  # Disturbances and tail of the evidence without a change
    name: str  # Name of the rig, or path of its file


def open_rig(name: str) -> TwinRig:
    """Read a rig file or a twin file."""
    path = Path(name)
    calibration = DEFAULT_CALIBRATION
    rig_name = name
    if path.suffix == ".toml" and path.is_file():
        data = _parse_file(path)
        if "tail" in data and "disturbances" in data:
            calibration = parse_calibration(data, name)
            rig_entry = data.get("rig")
            if not isinstance(rig_entry, str) or not rig_entry:
                raise TwinError(f"{name} names no rig", "write it again with heli-host twin --learn")
            rig_path = path.parent / rig_entry
            rig_name = str(rig_path) if rig_path.is_file() else rig_entry
    rig = load_rig(rig_name)
    model = model_named(rig.model or "multibody", effects_of(rig))
    return TwinRig(rig, model, calibration, rig_name)


def _parse_file(path: Path) -> dict[str, Any]:
    """Return the content of a TOML file; a TwinError is raised if it cannot be read."""
    try:
        return parse_toml(decode_text(read_file(path, TOML_BYTES)))
    except OSError as error:
        raise TwinError(f"cannot read {path}: {error.strerror or error}", file_remedy(error)) from error
    except ValueError as error:
        raise TwinError(f"{path} is not TOML: {error}", "correct that line") from error

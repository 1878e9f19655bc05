"""A rig for a twin, from its name, its file, or a twin's file that names both rig and calibration."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

from heli_host.files import TOML_BYTES, parse_toml, read_file
from heli_sim.model.base import Model
from heli_sim.model.effects import effects_of
from heli_sim.model.named import model_named
from heli_sim.rig import Rig, load_rig

from heli_lab.errors import TwinError
from heli_lab.twin.calibration import QUIET, Calibration, Tail, parse_calibration

USUAL: Final = Calibration(QUIET, Tail(5.37, 145.0, 1.0, 29), "a quiet room")
"""For a rig of which nothing was learned: the tail of simulated flights of the rig makki2024 in that
weather."""


@dataclass(frozen=True)
class TwinRig:
    """A rig, its equations with their effects, and what is normal of it.

    Parameters
    ----------
    rig : Rig
        Numbers.
    model : Model
        Equations.
    calibration : Calibration
        Weather and tail.
    name : str
        Name of the rig, or path of its file.
    """

    rig: Rig
    model: Model
    calibration: Calibration
    name: str


def open_rig(name: str) -> TwinRig:
    """Read a rig, or a twin's file.

    Parameters
    ----------
    name : str
        Name of a rig, path of its file, or of a twin's file; a rig's path in that is taken from its folder.

    Raises
    ------
    SimError
        There is none, or something in it is wrong.
    """
    path = Path(name)
    calibration = USUAL
    rig_name = name
    if path.suffix == ".toml" and path.is_file():
        data = _parsed(path)
        if "tail" in data and "disturbances" in data:
            calibration = parse_calibration(data, name)
            stated = data.get("rig")
            if not isinstance(stated, str) or not stated:
                raise TwinError(f"{name} names no rig", "write it again with heli-host twin --learn")
            beside = path.parent / stated
            rig_name = str(beside) if beside.is_file() else stated
    rig = load_rig(rig_name)
    model = model_named(rig.model or "multibody", effects_of(rig))
    return TwinRig(rig, model, calibration, rig_name)


def _parsed(path: Path) -> dict[str, Any]:
    try:
        return parse_toml(read_file(path, TOML_BYTES).decode("utf-8"))
    except OSError as error:
        raise TwinError(f"cannot read {path}: {error.strerror or error}", "check the path") from error
    except ValueError as error:
        raise TwinError(f"{path} is not TOML: {error}", "correct that line") from error

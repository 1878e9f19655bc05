"""Choose the rig for which the file of a law designs its controller: by ``--rig``, or the file's default."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from heli_sim.rig import Rig

RIG_VARIABLE: Final = "HELI_LAW_RIG"
"""Environment variable with the name or the file of the rig."""


def law_rig(default: str | Path = "makki2024") -> Rig:
    """Return the rig that ``--rig`` of the command names, otherwise the default.

    Without a command, as in ``python mine.py``, the environment variable ``HELI_LAW_RIG`` names the rig.

    Parameters
    ----------
    default : str or Path
        Name of a shipped rig, or path of a TOML file.

    Raises
    ------
    RigError
        There is no such rig, or its file is invalid.

    Examples
    --------
    >>> law_rig("quanser-course").name
    'quanser-course'
    """
    from heli_sim.rig import load_rig

    return load_rig(os.environ.get(RIG_VARIABLE) or default)


def rig_environment(rig: str | None) -> Mapping[str, str]:
    """Return the environment variable that states the rig for `law_rig` in another process."""
    if rig is None:
        return {}
    path = Path(rig)
    # The process may run in another folder.
    return {RIG_VARIABLE: str(path.absolute()) if path.is_file() else rig}

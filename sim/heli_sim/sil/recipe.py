"""The settings and file digests that a log needs so that its simulated flight can be repeated."""

from __future__ import annotations

import json
from pathlib import Path

from heli_host.data.files import file_digest

from heli_sim.rig import Rig
from heli_sim.rig.write import rig_text
from heli_sim.sil.boards import Choice
from heli_sim.sil.options import SilOptions

_EXACT_DIGITS = 17


def recipe_of(url: str, options: SilOptions, rig: Rig, choice: Choice) -> dict[str, str]:
    """Return the address of the simulation, the whole rig, and digests of the files that it executes.

    `heli_host.ui.cli.flight` reads this recipe from a log and repeats the flight. The recipe has no code,
    because a log from another person must not execute code.
    """
    return {
        "address": url,
        "rig_name": rig.name,
        "rig": rig_text(rig, digits=_EXACT_DIGITS),
        "effect_files": json.dumps({file: file_digest(Path(file)) for file in options.effect_files}),
        "flash": options.flash_file,
        "firmware": file_digest(Path(choice.elf)) if choice.elf else "",
    }

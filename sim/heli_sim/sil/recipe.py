"""All that is needed to repeat a simulated flight, as text for the log."""

from __future__ import annotations

import json
from pathlib import Path

from heli_host.files import file_digest

from heli_sim.rig import Rig
from heli_sim.rig.write import rig_text
from heli_sim.sil.boards import Choice
from heli_sim.sil.options import SilOptions

_EXACT_DIGITS = 17


def recipe_of(url: str, options: SilOptions, rig: Rig, choice: Choice) -> dict[str, str]:
    """Return what a repetition needs: the address of the simulation, the whole rig, and digests of the files
    that it executes.

    The host's `heli_host.cli.again` reads it from a log. Code is not in it: a log from another person must
    not bring code that runs.

    Parameters
    ----------
    url : str
        Address of the board, with seed, effects and model.
    options : SilOptions
        Options of that address.
    choice : Choice
        The board that flies.
    """
    return {
        "address": url,
        "rig_name": rig.name,
        "rig": rig_text(rig, digits=_EXACT_DIGITS),
        "effect_files": json.dumps({file: file_digest(Path(file)) for file in options.effect_files}),
        "flash": options.flash_file,
        "firmware": file_digest(Path(choice.elf)) if choice.elf else "",
    }

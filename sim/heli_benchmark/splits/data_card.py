"""Data card of a split, for people and, as Croissant metadata, for programs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import heli_host

from heli_benchmark.splits.croissant import COLUMNS, LICENCE, croissant_content
from heli_benchmark.task.json_file import write_json

CARD_FILE: Final = "README.md"
CROISSANT_FILE: Final = "croissant.json"
_OPEN: Final = (
    """The truth of each case is in `truth`. Seed {seed} of heli-lab {release} draws the same cases again."""
)
_SEALED: Final = """The truth is not in this folder. `commitments.json` has the SHA-256 digest of each
truth; it was written before any method ran. The file of a truth includes random digits, its salt, so that
nobody can guess a truth from its digest. Check a published truth with `sha256sum case-001.json`.

The cases are drawn from a secret with the digest `{secret_sha256}`.
Whoever has the secret makes the same flights and truths again with heli-lab {release}."""
_CARD: Final = """# {name}: flights with hidden causes

{description}

| | |
|---|---|
| cases | {count}, one folder each in `cases` |
| made by | heli-lab {release}, `heli-host benchmark make` |
| licence | data: [CC BY 4.0]({licence}); program: MIT |
| metadata | `croissant.json`, Croissant 1.0 |

## How the flights were made

MuJoCo simulates a laboratory helicopter with three degrees of freedom; no person and no real machine is in
the data. Each case draws one of two types of rig, one of three controllers, and a rate of 100 to 500 Hz. It
also draws random torques, such as draughts, and the errors of the rig parameters. None of these draws depends
on the hidden causes.

In a third of the cases nothing is hidden. The others hide one to three causes of `causes.json`, or an
equation that this list does not have, called `unlisted`.

## Files of a case

| file | content |
|---|---|
| `rig.toml` | nominal parameters; a tolerance is two standard deviations |
| `training-1.csv` and more | flights to learn from |
| `validation-1.csv` and more | flights to check on |
| the same names with `.parquet` | the same numbers |

| column | meaning |
|---|---|
{columns}

## The truth

{truth}

## Intended use and limits

Use it to compare methods that find, name and measure hidden causes. Do not train on a split that you score.
Simulated rigs are simpler than real ones. No cable moves and no bearing wears; each case has causes of this
list or one unlisted equation. A method that does well here may still fail on a real rig.
"""


def write_card(folder: Path, content: Mapping[str, Any]) -> None:
    """Write README.md and croissant.json into the folder of a split."""
    name, release = f"heli-lab {content['split']}", heli_host.__version__
    description = (
        f"{content['count']} cases of a simulated laboratory helicopter. A method gets flights of a rig, and "
        "names what differs from the model of the rig, or that nothing does."
    )
    truth = (_OPEN if "seed" in content else _SEALED).format(**content, release=release)
    columns = "\n".join(f"| `{column}` | {meaning} |" for column, meaning in COLUMNS.items())
    card = _CARD.format(
        name=name,
        description=description,
        count=content["count"],
        release=release,
        licence=LICENCE,
        columns=columns,
        truth=truth,
    )
    (folder / CARD_FILE).write_text(card, encoding="utf-8")
    write_json(folder / CROISSANT_FILE, croissant_content(folder, name, release, description))

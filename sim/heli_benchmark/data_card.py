"""Data card of a split, for people and, as Croissant metadata, for programs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

import heli_host
from heli_host.data.files import file_digest

from heli_benchmark.task import CAUSES_FILE, write_json

LICENCE: Final = "https://creativecommons.org/licenses/by/4.0/"
COLUMNS: Final = {
    "t_s": "time since the start of the flight, in seconds",
    "front_V": "voltage of the front motor, in volts",
    "back_V": "voltage of the back motor, in volts",
    "elevation_rad": "elevation of the arm, in radians",
    "pitch_rad": "pitch of the helicopter, in radians",
    "travel_rad": "travel of the arm, in radians",
}
"""Columns of a flight and their meanings."""
_CITATION: Final = "heli-lab: a benchmark of hidden causes in flights of a 3-DOF laboratory helicopter"
_CONTEXT: Final = {
    "@language": "en",
    "@vocab": "https://schema.org/",
    "sc": "https://schema.org/",
    "cr": "http://mlcommons.org/croissant/",
    "dct": "http://purl.org/dc/terms/",
    "rai": "http://mlcommons.org/croissant/RAI/",
    "data": {"@id": "cr:data", "@type": "@json"},
    "dataType": {"@id": "cr:dataType", "@type": "@vocab"},
    "examples": {"@id": "cr:examples", "@type": "@json"},
    "conformsTo": "dct:conformsTo",
    **{
        term: f"cr:{term}"
        for term in (
            *("citeAs", "column", "equivalentProperty", "extract", "field", "fileObject", "fileProperty"),
            *("fileSet", "format", "includes", "isLiveDataset", "jsonPath", "key", "md5", "parentField"),
            *("path", "recordSet", "references", "regex", "repeated", "replace", "samplingRate"),
            *("separator", "source", "subField", "transform"),
        )
    },
}


def croissant_content(folder: Path, name: str, release: str, description: str) -> dict[str, Any]:
    """Return the metadata of a split."""
    return {
        "@context": _CONTEXT,
        "@type": "sc:Dataset",
        "conformsTo": "http://mlcommons.org/croissant/1.0",
        "name": name,
        "description": description,
        "version": release,
        "license": LICENCE,
        "citeAs": _CITATION,
        "creator": {"@type": "sc:Organization", "name": "heli-lab"},
        "distribution": [
            {
                "@type": "cr:FileObject",
                "@id": "causes",
                "name": "causes",
                "description": "names of all causes, their parameters and base rates",
                "contentUrl": CAUSES_FILE,
                "encodingFormat": "application/json",
                "sha256": file_digest(folder / CAUSES_FILE),
            },
            *(_flight_file_set(kind) for kind in ("training", "validation")),
        ],
        "recordSet": [_record_set_of_rows(kind) for kind in ("training", "validation")],
    }


def _flight_file_set(kind: str) -> dict[str, Any]:
    """Return the description of all flight files of a kind, training or validation."""
    return {
        "@type": "cr:FileSet",
        "@id": f"{kind}-flights",
        "name": f"{kind}-flights",
        "description": f"all {kind} flights; the folder of a file is its case",
        "encodingFormat": "text/csv",
        "includes": f"cases/*/{kind}-*.csv",
    }


def _record_set_of_rows(kind: str) -> dict[str, Any]:
    """Return the description of the columns in the flight files of a kind."""
    source = {"fileSet": {"@id": f"{kind}-flights"}}
    columns = {
        "file": ("path of the flight", "sc:Text", {"fileProperty": "fullpath"}),
        **{name: (text, "sc:Float", {"column": name}) for name, text in COLUMNS.items()},
    }
    return {
        "@type": "cr:RecordSet",
        "@id": f"{kind}-rows",
        "name": f"{kind}-rows",
        "description": f"rows of all {kind} flights",
        "field": [
            {
                "@type": "cr:Field",
                "@id": f"{kind}-rows/{name}",
                "name": name,
                "description": text,
                "dataType": type_,
                "source": {**source, "extract": extract},
            }
            for name, (text, type_, extract) in columns.items()
        ],
    }


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

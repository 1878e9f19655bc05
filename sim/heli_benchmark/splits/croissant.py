"""Croissant metadata of a split: programs that know the format load its flights without further code.

The vocabulary is that of Croissant 1.0, https://docs.mlcommons.org/croissant/docs/croissant-spec.html.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, Final

from heli_host.data.files import file_digest

from heli_benchmark.task.split import CAUSES_FILE

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

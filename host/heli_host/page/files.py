"""The files that a page is made of: all from this package, none from anywhere else."""

from __future__ import annotations

import gzip
from collections.abc import Mapping
from importlib.resources import files
from pathlib import PurePosixPath

from starlette.responses import PlainTextResponse, Response

_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
_HEADERS = {
    # A page of this package loads nothing from elsewhere, and what would make it is refused.
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cache-Control": "no-cache",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


def page_file(path: str, headers: Mapping[str, str]) -> Response:
    """Return one of the files, or that there is none.

    Parameters
    ----------
    path : str
        As asked for, without the first slash; empty for the page itself.
    headers : Mapping of str to str
        Of the request.
    """
    place = PurePosixPath(path or "index.html")
    kind = _TYPES.get(place.suffix)
    if kind is None or ".." in place.parts or place.is_absolute():
        return PlainTextResponse("there is no such file\n", 404)
    folder = files(__package__) / "static"
    plain, packed = folder.joinpath(*place.parts), folder.joinpath(*place.parts[:-1], f"{place.name}.gz")
    if plain.is_file():
        return Response(plain.read_bytes(), media_type=kind, headers=_HEADERS)
    if not packed.is_file():
        return PlainTextResponse("there is no such file\n", 404)
    body = packed.read_bytes()
    if "gzip" not in headers.get("accept-encoding", ""):
        return Response(gzip.decompress(body), media_type=kind, headers=_HEADERS)
    return Response(body, media_type=kind, headers={**_HEADERS, "Content-Encoding": "gzip"})

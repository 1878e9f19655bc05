"""The static files of the page. All are part of this package; the page loads nothing from the internet."""

from __future__ import annotations

import gzip
from collections.abc import Mapping
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import PurePosixPath

from starlette.responses import PlainTextResponse, Response

_PACKED = ".gz"
_TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript", ".svg": "image/svg+xml"}
_HEADERS = {
    # The policy forbids the page to load anything from another server, even if its code were changed.
    "Content-Security-Policy": "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; "
    "connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'",
    "Cache-Control": "no-cache",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}


def page_file(path: str, headers: Mapping[str, str]) -> Response:
    """Return the response for a static file; 404 if no file has this name."""
    # Only listed names are served, so that no text of a client becomes a path in the file system.
    stored = _files_by_path().get(path or "index.html")
    if stored is None:
        return PlainTextResponse("there is no such file\n", 404)
    kind, body = _TYPES[PurePosixPath(path or "index.html").suffix], stored.read_bytes()
    if not stored.name.endswith(_PACKED):
        return Response(body, media_type=kind, headers=_HEADERS)
    if "gzip" not in headers.get("accept-encoding", ""):
        return Response(gzip.decompress(body), media_type=kind, headers=_HEADERS)
    return Response(body, media_type=kind, headers={**_HEADERS, "Content-Encoding": "gzip"})


@cache
def _files_by_path() -> dict[str, Traversable]:
    """All files that are served, by their paths as a browser asks for them."""
    served: dict[str, Traversable] = {}
    folders = [("", files(__package__) / "static")]
    while folders:
        prefix, folder = folders.pop()
        for file in folder.iterdir():
            name = f"{prefix}{file.name.removesuffix(_PACKED)}"
            if file.is_dir():
                folders.append((f"{name}/", file))
            elif PurePosixPath(name).suffix in _TYPES:
                served[name] = file
    return served

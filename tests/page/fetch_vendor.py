"""Write the page's copies of other people's code from npm's tarballs, whose hashes are pinned.

``python tests/page/fetch_vendor.py``: needed only when a version in ``vendor.toml`` changes.
"""

import base64
import gzip
import hashlib
import io
import sys
import tarfile
import tomllib
import urllib.request
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).resolve().parents[2] / "host" / "heli_host" / "ui" / "page" / "static" / "vendor"


def pinned() -> dict[str, Any]:
    """What is pinned: version, address, hash and files of each package."""
    with (FOLDER / "vendor.toml").open("rb") as file:
        return tomllib.load(file)


def integrity(data: bytes) -> str:
    """The hash of a tarball as npm writes it."""
    return "sha512-" + base64.b64encode(hashlib.sha512(data).digest()).decode()


def stored(name: str) -> Path:
    """Where a file is kept; licences are kept as they are, everything else compressed."""
    return FOLDER / (name if name.endswith("LICENSE") else f"{name}.gz")


def unpacked(tarball: bytes, files: dict[str, str]) -> dict[str, bytes]:
    """The files of a tarball that are kept, by the names they are kept under."""
    contents: dict[str, bytes] = {}
    with tarfile.open(fileobj=io.BytesIO(tarball)) as tar:
        for name, member in files.items():
            entry = tar.extractfile(member)
            assert entry is not None
            contents[name] = entry.read()
    return contents


def main() -> int:
    """Fetch and write them."""
    for package, entry in pinned().items():
        with urllib.request.urlopen(entry["url"], timeout=60) as answer:
            tarball = answer.read()
        if integrity(tarball) != entry["integrity"]:
            print(f"{package}: the tarball is not the one that was pinned", file=sys.stderr)
            return 1
        for name, data in unpacked(tarball, entry["files"]).items():
            path = stored(name)
            # Without a time in it, the same file is the same bytes.
            path.write_bytes(data if path.suffix != ".gz" else gzip.compress(data, 9, mtime=0))
            print(f"{package} {entry['version']}: {path.name}, {path.stat().st_size} bytes")
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Fetch the vendor's register description ATSAM3X8E.svd out of PyPI's source archive of cmsis-svd 0.4.

``python sim/due/tests/fetch_svd.py [FOLDER]``: 35 MB once, into ``build/svd`` unless a folder is given.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tarfile
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]
DEFAULT = ROOT / "build" / "svd"
NAME = "ATSAM3X8E.svd"
MEMBER = f"cmsis-svd-0.4/cmsis_svd/data/Atmel/{NAME}"
MISSING = f"{NAME} is missing: python sim/due/tests/fetch_svd.py"


def find() -> Path | None:
    """The description: where the environment variable HELI_SVD says, or where `main` puts it."""
    places = (Path(os.environ.get("HELI_SVD", "")), DEFAULT / NAME)
    return next((path for path in places if path.is_file()), None)


def main(folder: Path) -> int:
    """Fetch it, unless it is there."""
    target = folder / NAME
    if target.exists():
        return 0
    with tempfile.TemporaryDirectory() as scratch:
        command = [
            sys.executable,
            "-m",
            "pip",
            "download",
            "--quiet",
            "--no-deps",
            "--no-binary",
            "cmsis-svd",
        ]
        result = subprocess.run([*command, "--dest", scratch, "cmsis-svd==0.4"], check=False)
        if result.returncode != 0:
            print("cmsis-svd 0.4 cannot be downloaded: its test will skip", file=sys.stderr)
            return 1
        archive = next(Path(scratch).glob("*.tar.gz"))
        with tarfile.open(archive) as tar:
            source = tar.extractfile(MEMBER)
            assert source is not None
            folder.mkdir(parents=True, exist_ok=True)
            target.write_bytes(source.read())
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]) if len(sys.argv) > 1 else DEFAULT))

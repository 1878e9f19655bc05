"""Fetch and read ATSAM3X8E.svd, the vendor's register description, from the source archive of cmsis-svd 0.4.

``python sim/due/tests/fetch_svd.py [FOLDER]``: 35 MB once, into ``build/svd`` unless a folder is given.
"""

import os
import subprocess
import sys
import tarfile
import tempfile
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

ROOT = Path(__file__).resolve().parents[3]
DEFAULT = ROOT / "build" / "svd"
NAME = "ATSAM3X8E.svd"
MEMBER = f"cmsis-svd-0.4/cmsis_svd/data/Atmel/{NAME}"
MISSING = f"{NAME} is missing: python sim/due/tests/fetch_svd.py"


def find() -> Path | None:
    """The description: where the environment variable HELI_SVD says, or where `main` puts it."""
    places = (Path(os.environ.get("HELI_SVD", "")), DEFAULT / NAME)
    return next((path for path in places if path.is_file()), None)


@dataclass(frozen=True)
class Register:
    """One register, or an array of them."""

    peripheral: str
    name: str  # Its name in the description; an array's ends in [%s]
    offset: int  # From the start of its peripheral
    access: str  # read-only, write-only or read-write
    reset: int | None
    count: int  # Length of an array; 1 for a single register
    step: int  # Bytes from one register of an array to the next
    fields: dict[str, tuple[int, int]]  # Lowest bit and width of each field
    values: dict[tuple[str, str], int]  # Values of fields that have names, by field and name


@dataclass(frozen=True)
class Peripheral:
    """One peripheral."""

    address: int  # Where it begins
    registers: dict[str, Register]  # By name, without the peripheral's prefix


@dataclass(frozen=True)
class Description:
    """The chip."""

    peripherals: dict[str, Peripheral]  # By name
    # Number of each interrupt, which is also the identifier of the peripheral's clock
    interrupts: dict[str, int]


def description() -> Description | None:
    """Read the description; None if it has not been fetched."""
    path = find()
    if path is None:
        return None
    peripherals, interrupts = {}, {}
    for node in ElementTree.parse(path).getroot().iter("peripheral"):
        name = _text(node, "name")
        registers = {}
        for element in node.iter("register"):
            register = _register(name, element)
            short = register.name.removesuffix("[%s]")
            for prefix in (f"{name}_", f"{name.rstrip('0123456789')}_"):
                short = short.removeprefix(prefix)
            registers[short] = register
        peripherals[name] = Peripheral(int(_text(node, "baseAddress"), 0), registers)
        for interrupt in node.findall("interrupt"):
            interrupts[_text(interrupt, "name")] = int(_text(interrupt, "value"), 0)
    return Description(peripherals, interrupts)


def _register(peripheral: str, node: ElementTree.Element) -> Register:
    fields, values = {}, {}
    for field in node.iter("field"):
        name = _text(field, "name")
        lowest_bit = int(_text(field, "bitOffset") or _text(field, "lsb"), 0)
        fields[name] = lowest_bit, int(_text(field, "bitWidth") or "1")
        for value in field.iter("enumeratedValue"):
            values[name, _text(value, "name")] = int(_text(value, "value"), 0)
    reset = _text(node, "resetValue")
    return Register(
        peripheral=peripheral,
        name=_text(node, "name"),
        offset=int(_text(node, "addressOffset"), 0),
        access=_text(node, "access"),
        reset=int(reset, 0) if reset else None,
        count=int(_text(node, "dim") or "1", 0),
        step=int(_text(node, "dimIncrement") or "0", 0),
        fields=fields,
        values=values,
    )


def _text(node: ElementTree.Element, name: str) -> str:
    return (node.findtext(name) or "").strip()


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

"""A stand-in for ``bossac``: prints its version, writes its arguments to a file, and ends as the test
demands."""

import json
import sys
from pathlib import Path

NEW_USB = "  -U, --usb-port[=BOOL] force serial port detection to USB if BOOL is 1 [default]"
OLD_USB = "  -U, --force_usb_port=true/false override USB port autodetection"

# Output and exit code of bossac, from its source.
ENDINGS = {
    "good": ("Write 28612 bytes to flash (112 pages)\nVerify successful\nSet boot flash true\n", 0),
    "no device": ("No device found on ttyACM0\n", 1),
    "verify": ("\nVerify failed\nPage errors: 1\nByte errors: 17\n", 2),
    "options": (
        "bossac: extra arguments found\nTry 'bossac -h' or 'bossac --help' for more information\n",
        1,
    ),
    "io": ("\nSAM-BA operation failed\n", 1),
}

_PROGRAM = """#!{python}
import json, os, sys, time
if "--help" in sys.argv:
    print("Basic Open Source SAM-BA Application (BOSSA) Version {version}")
    print({usb!r})
    sys.exit(1)
with open({notes!r}, "a") as notes:
    notes.write(json.dumps(sys.argv[1:]) + "\\n")
if {ending!r} == "crash":
    os.abort()
if {ending!r} == "hang":
    time.sleep(60)
text, code = {endings!r}[{ending!r}]
print(text)
sys.exit(code)
"""


class Uploader:
    """A program in a folder of its own; `ending` is a key of `ENDINGS`, ``crash`` or ``hang``."""

    def __init__(self, folder: Path, ending: str = "good", version: str = "1.7.0") -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self.program = folder / "bossac"
        self._notes = folder / "notes"
        usb = OLD_USB if version < "1.8" else NEW_USB
        text = _PROGRAM.format(
            python=sys.executable,
            version=version,
            usb=usb,
            notes=str(self._notes),
            ending=ending,
            endings=ENDINGS,
        )
        self.program.write_text(text)
        self.program.chmod(0o755)

    @property
    def calls(self) -> list[list[str]]:
        """Arguments of each time it was to write."""
        if not self._notes.exists():
            return []
        return [json.loads(line) for line in self._notes.read_text().splitlines()]

"""Calibrates a rig with each of the 64 combinations of wrong wires, and thrust and dead zone of two rigs.

    python -m tests.calibrate.calibrate_all

Prints one line per combination that is wrong, then the errors of thrust and dead zone. Exits with 1 if one is
beyond its tolerance. Takes about two minutes.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from heli_host.errors import HeliError

from tests.calibrate.rigs import (
    ALL,
    DEAD_ZONE_V,
    GAIN_SHARE,
    HIDDEN,
    Wires,
    calibrated,
    errors_of,
    wires_found,
)


def main() -> int:
    """Calibrate all, and return 1 if something was not found."""
    bad = 0
    with tempfile.TemporaryDirectory() as folder:
        for name in HIDDEN:
            gains, zeros = [], []
            for wires in ALL:
                try:
                    result = calibrated(Path(folder), name, wires)
                    outcome: Wires | str = wires_found(result)
                    gain, zero_V = errors_of(result, name)
                except HeliError as error:
                    outcome, gain, zero_V = str(error), 1.0, 1.0
                gains.append(abs(gain))
                zeros.append(abs(zero_V))
                if outcome != wires or abs(gain) > GAIN_SHARE or abs(zero_V) > DEAD_ZONE_V:
                    bad += 1
                    print(f"{name}: {wires}: {outcome}, thrust {gain:+.1%}, dead zone {zero_V:+.3f} V")
            print(
                f"{name}: {len(ALL)} combinations; largest error of thrust {max(gains):.1%}, "
                f"of the dead zone {max(zeros):.3f} V",
                flush=True,
            )
    print(f"{bad} wrong")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())

"""``python -m tests.pool.coverage``: standard errors of a rig's parameters from several flights together.

Prints how they fall with the root of the number of flights, for parameters that one flight identifies, and
how often the true value is within two of them.
"""

from __future__ import annotations

import numpy as np

from tests.pool.flights import BY_FLIGHTS, FLIGHTS, normalised_errors, shares_of_one

RIGS = range(1, 13)


def main() -> None:
    """Print ratios and coverage."""
    for name in BY_FLIGHTS:
        shares = shares_of_one(name, RIGS)
        print(
            f"{name}: {FLIGHTS} flights over one, times the root of {FLIGHTS}: mean {np.mean(shares):.2f}, "
            f"{min(shares):.2f} to {max(shares):.2f} on {len(shares)} rigs",
            flush=True,
        )
    for count in (1, FLIGHTS):
        every = normalised_errors(count, RIGS)
        print(
            f"{count} flights: {np.mean(np.abs(every) < 2.0):.1%} of {len(every)} numbers within 2 standard "
            f"errors, rms {np.sqrt(np.mean(every**2)):.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()

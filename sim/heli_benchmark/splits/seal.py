"""Secret of a sealed split: it draws the cases and salts the commitments to their truths."""

from __future__ import annotations

import hashlib
import hmac
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from heli_host.data.files import read_file

from heli_benchmark.errors import BenchmarkError

MIN_HEX_DIGITS: Final = 32
"""Shortest secret: 128 bits, as `openssl rand -hex 16` prints. A program could try all shorter ones: it
draws the cases of each, and compares the flights."""
_MOST_BYTES: Final = 1 << 20


@dataclass(frozen=True)
class Seal:
    """Secret of a sealed split."""

    secret: str  # Random hexadecimal digits

    @property
    def seed(self) -> int:
        """Seed of the cases, 256 bits."""
        return int(self._derived_key("cases"), 16)

    @property
    def digest(self) -> str:
        """SHA-256 of the secret. It is published with the split, and the secret after the scores."""
        return hashlib.sha256(self.secret.encode()).hexdigest()

    def salt(self, case: str) -> str:
        """Return random digits for the truth of a case.

        Without them, anybody could hash all truths that a case may have until one agrees with its commitment.
        """
        return self._derived_key(f"salt of {case}")

    def _derived_key(self, purpose: str) -> str:
        return hmac.new(bytes.fromhex(self.secret), purpose.encode(), hashlib.sha256).hexdigest()


def read_seal(path: Path) -> Seal:
    """Read a secret from its file."""
    remedy = "write random digits into it with `openssl rand -hex 32`"
    try:
        secret = read_file(path, _MOST_BYTES).decode("ascii").strip().lower()
        bytes.fromhex(secret)
    except OSError as error:
        raise BenchmarkError(f"cannot read {path}: {error.strerror or error}", remedy) from None
    except ValueError:
        raise BenchmarkError(f"{path} is not one line of hexadecimal digits", remedy) from None
    if len(secret) < MIN_HEX_DIGITS or len(set(secret)) < 4:
        raise BenchmarkError(f"the secret in {path} can be guessed: {len(secret)} digits", remedy)
    return Seal(secret)

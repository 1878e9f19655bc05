"""Blind flights, whose cause is hidden: the permitted content of their logs, and a seal over the rest.

The seal is a SHA-256 digest of the hidden facts and a random salt. It fixes the answer beforehand without
revealing it: without the salt, trying all effects does not reproduce the digest. The truth file contains the
answer and the salt, for the person who hid the effect.
"""

from __future__ import annotations

import hashlib
import json
import re
import secrets
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from heli_host.data.files import RESULT_SCHEMA, file_digest, read_file, replacing
from heli_host.data.flight import Flight
from heli_host.errors import LogError, LogWriteError, file_remedy

SEALED: Final = "sealed"
"""Name of the digest in a log's session and in the notes of an export."""
TRUTH_END: Final = ".truth.json"
TWIN_EVENT: Final = "twin"
"""Name of a twin's events, `heli_host.board.twins.EVENT`."""
_PERMITTED_NOTES: Final = frozenset(
    (
        *("axes", "board", "boot_fault", "firmware", "host", "host_link", "host_link_hash"),
        *("law_signals", "link", "link_hash", "params_source", "reset", "start", SEALED),
    )
)
"""Notes that a blind flight keeps; any other note may name the hidden rig or effect. The boot id follows from
the seed."""
_RESULT: Final = "result."
_ADDRESS: Final = re.compile(r"\b\w+://\S*[^\s:;,.]")
_BOOT_ID: Final = re.compile(r"\bboot id \d+")
_MAX_BYTES: Final = 4 << 20
"""Largest size of a truth file; the rig file in it has 10 kB."""


@dataclass(frozen=True)
class Truth:
    """The hidden facts of a blind flight, and the salt of their seal."""

    flown: Mapping[str, Any]  # Hidden facts of a blind flight, as JSON values: rig, effects, seed, address
    salt: str  # Random text

    @classmethod
    def seal(cls, flown: Mapping[str, Any]) -> Truth:
        """Seal the hidden facts, `flown`, with a new salt."""
        return cls(dict(flown), secrets.token_hex(16))

    @property
    def digest(self) -> str:
        """The seal: SHA-256 of the salt and of the hidden facts as JSON with sorted keys and no spaces."""
        text = json.dumps(self.flown, sort_keys=True, separators=(",", ":"), ensure_ascii=True)
        return "sha256:" + hashlib.sha256(f"{self.salt}{text}".encode()).hexdigest()

    def write(self, path: Path) -> None:
        """Write the truth file `path`, which only its owner may read; a missing folder is made."""
        content = {"schema": RESULT_SCHEMA, "sealed": self.digest, "salt": self.salt, "flown": self.flown}
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as unfinished:
                unfinished.touch(mode=0o600)
                unfinished.write_text(json.dumps(content, indent=2) + "\n", encoding="utf-8")
            path.chmod(0o600)
        except OSError as error:
            raise LogWriteError(
                f"cannot write {path}: {error.strerror or error}", "choose another folder"
            ) from error

    @classmethod
    def read(cls, path: Path) -> Truth:
        """Read the truth file `path`."""
        try:
            content = json.loads(read_file(path, _MAX_BYTES))
            flown, salt = content["flown"], content["salt"]
        except OSError as error:
            raise LogError(f"cannot read {path}: {error.strerror or error}", file_remedy(error)) from error
        except (ValueError, KeyError, TypeError, RecursionError) as error:
            raise LogError(f"{path} is not a truth file", "give the .truth.json of the flight") from error
        if not isinstance(flown, dict) or not isinstance(salt, str):
            raise LogError(f"{path} is not a truth file", "give the .truth.json of the flight")
        return cls(flown, salt)

    def check(self, path: Path, sealed: str) -> None:
        """Compare with the seal of a flight."""
        matches = sealed == self.digest if sealed else self.flown.get("log_sha256") == _log_digest(path)
        if not matches:
            raise LogError(
                f"the truth file does not match {path}: its seal is {self.digest}, the flight's is "
                f"{sealed or 'none, and its bytes differ'}",
                "give the truth file of this flight; otherwise one of the two files was changed",
            )


def truth_path(log: Path) -> Path:
    """Return the place of the truth file of a `log`."""
    return log.with_name(log.name.removesuffix(".gz").rpartition(".")[0] + TRUTH_END)


def hide(text: str) -> str:
    """Remove addresses and boot ids from a `text`: an address contains rig, effects and seed, and the seed
    determines the boot id.
    """
    return _BOOT_ID.sub("boot id hidden", _ADDRESS.sub("the board", text))


def blind_notes(session: Mapping[str, str], sealed: str) -> dict[str, str]:
    """Return the notes of `session` that a blind flight may contain, with its seal, `sealed`."""
    return {name: hide(text) for name, text in session.items() if name in _PERMITTED_NOTES} | {SEALED: sealed}


def blind(flight: Flight, sealed: str) -> Flight:
    """Return a flight without the data that reveal its rig and its effects."""
    results = {name: hide(text) for name, text in flight.meta.items() if name.startswith(_RESULT)}
    return replace(
        flight,
        meta=blind_notes(flight.meta, sealed) | results,
        events=tuple(
            replace(event, text=hide(event.text)) for event in flight.events if event.name != TWIN_EVENT
        ),
    )


def sealed_truth(flight: Flight, log: Path) -> Truth | None:
    """Seal the notes of a flight that a blind export omits."""
    if flight.meta.get(SEALED):
        return None
    hidden_notes = {name: text for name, text in flight.meta.items() if name not in _PERMITTED_NOTES}
    flown = {
        "log_sha256": _log_digest(log),
        **{name: text for name, text in hidden_notes.items() if not name.startswith(_RESULT)},
    }
    path = truth_path(log)
    if not path.exists():
        return Truth.seal(flown)
    existing = Truth.read(path)
    if existing.flown != flown:
        raise LogError(
            f"{path} is the truth file of another flight", "move it to another folder, or rename the log"
        )
    return existing


def _log_digest(path: Path) -> str:
    """Return the SHA-256 of a log; a LogError if it cannot be read."""
    try:
        return file_digest(path)
    except OSError as error:
        raise LogError(f"cannot read {path}: {error.strerror or error}", file_remedy(error)) from error

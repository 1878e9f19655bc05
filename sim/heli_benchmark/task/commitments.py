"""Commitments to the truth of a sealed split: digests that are published before any method runs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from heli_host.data.files import file_digest

from heli_benchmark.errors import BenchmarkError
from heli_benchmark.task.json_file import read_json, write_json

COMMITMENTS_FILE: Final = "commitments.json"


def write_commitments(split_folder: Path, truth_folder: Path, names: list[str]) -> None:
    """Write the SHA-256 digest of each case's truth into the folder of the split."""
    digests = {name: file_digest(truth_folder / f"{name}.json") for name in names}
    write_json(split_folder / COMMITMENTS_FILE, {"sha256": digests})


def read_commitments(split_folder: Path) -> Mapping[str, str]:
    """Read the commitments in a `split_folder`: a digest by case."""
    remedy = "run the same `heli-host benchmark make` again, it continues"
    digests = read_json(split_folder / COMMITMENTS_FILE, remedy, ("sha256",))["sha256"]
    if not isinstance(digests, dict):
        raise BenchmarkError(f"{split_folder / COMMITMENTS_FILE} has no digests by case", remedy)
    return {str(name): str(digest) for name, digest in digests.items()}


def verify_commitment(truth_file: Path, digest: str | None) -> None:
    """Refuse a truth that is not the one the split committed to."""
    if digest is None:
        raise BenchmarkError(
            f"{COMMITMENTS_FILE} has no commitment to {truth_file.stem}", "use the split as it was published"
        )
    if not truth_file.exists():
        raise BenchmarkError(f"there is no truth {truth_file}", "give the folder of the truths with --truth")
    if file_digest(truth_file) != digest:
        raise BenchmarkError(
            f"{truth_file} is not the truth that the split committed to", "use the truth as it was written"
        )

"""One wrong register in any driver is noticed: each mutation must break its claim.

`make test` takes one in four of every file's mutations, `make long` all.
"""

from __future__ import annotations

import inspect
import os
import shutil
import subprocess
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
from heli_host.errors import HeliError

from firmware.due.report import Image, read_symbols
from tests.firmware.built import ROOT
from tests.firmware.desk import Board
from tests.firmware.mutations import MUTATIONS, Mutation
from tests.firmware.subtle_mutations import SUBTLE
from tests.running.long import parallel_map

pytestmark = pytest.mark.emulated

ALL = (*MUTATIONS, *SUBTLE)
SHARE = parallel_map(ALL, every=4, kind=lambda mutation: mutation.file)

due = pytest.importorskip("due_emulator._due", reason="the emulated Due is not built: make setup")
pytest.importorskip("elftools", reason="pyelftools is missing: make setup")


@dataclass(frozen=True)
class Workshop:
    """A copy of the firmware, compiled, in which one file at a time is spoilt."""

    folder: Path

    def make(self) -> Path:
        process = subprocess.run(
            [
                "make",
                "-s",
                "-C",
                self.folder / "due",
                f"BUILD={self.folder / 'build'}",
                self.folder / "build/heli.elf",
            ],
            capture_output=True,
            text=True,
            check=False,
        )
        assert process.returncode == 0, process.stderr
        return self.folder / "build" / "heli.elf"

    def spoilt(self, mutation: Mutation) -> Path:
        path = self.folder / ("" if "/" in mutation.file else "due") / mutation.file
        text = path.read_text()
        assert text.count(mutation.right) == 1, (
            f"{mutation.file} has {text.count(mutation.right)} of: {mutation.right}"
        )
        # Source and object come back together, so that make has nothing to build before the next one. A
        # header
        # has many objects: it comes back as changed.
        complete = self.folder / "build" / path.relative_to(self.folder).with_suffix(".o")
        kept = [(file, file.read_bytes(), file.stat()) for file in (path, complete) if file.exists()]
        path.write_text(text.replace(mutation.right, mutation.wrong))
        try:
            return self.make()
        finally:
            for file, content, status in kept:
                file.write_bytes(content)
                if len(kept) > 1:
                    os.utime(file, ns=(status.st_atime_ns, status.st_mtime_ns))


@pytest.fixture(scope="module")
def workshop(elf: Path, tmp_path_factory: pytest.TempPathFactory) -> Workshop:
    folder = tmp_path_factory.mktemp("mutants")
    for part in ("core", "due"):
        shutil.copytree(ROOT / "firmware" / part, folder / part)
    # Names that a mutation leaves unused are not the mistake that is looked for, and nobody debugs it.
    flags = folder / "due" / "compile.flags"
    flags.write_text(flags.read_text().replace("-Werror", "-w").replace("-g\n", ""))
    # What is compiled already is taken over, as if from the copied files; a rule names object and sources.
    build = shutil.copytree(elf.parent, folder / "build")
    for dependencies in build.rglob("*.d"):
        rules = dependencies.read_text().replace(str(elf.parent), str(build))
        dependencies.write_text(rules.replace(str(ROOT / "firmware"), str(folder)))
    for path in (*folder.rglob("*.flags"), *folder.rglob("Makefile")):
        os.utime(path, (0, 0))
    for path in build.rglob("*"):
        os.utime(path)
    return Workshop(folder)


@pytest.mark.parametrize("mutation", SHARE, ids=lambda m: f"{m.file}:{m.right.strip()[:40]}")
def test_a_wrong_register_is_noticed(workshop: Workshop, image: Image, mutation: Mutation) -> None:
    elf = workshop.spoilt(mutation)
    # Claims look only at where things are, and taking a program apart takes longer than most claims.
    image = replace(image, symbols=read_symbols(elf))
    takes_elf = "elf" in inspect.signature(mutation.claim).parameters
    with pytest.raises((AssertionError, HeliError, due.Stop, pytest.fail.Exception)):
        if takes_elf:
            mutation.claim(elf, image, *mutation.arguments)
        else:
            mutation.claim(Board(elf, image), *mutation.arguments)


def test_every_driver_has_a_mutation() -> None:
    # These three have no register of their own: arithmetic, memory, and calls into the drivers.
    without = {"memory.cpp", "due_board.cpp"}
    drivers = {path.name for path in (ROOT / "firmware" / "due").glob("*.cpp")} - without
    assert drivers <= {mutation.file for mutation in SHARE}

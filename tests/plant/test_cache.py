"""What is loaded from the cache of compiled functions is whole, and nobody else put it there."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys
from pathlib import Path

import pytest
from heli_sim.cache import cache_folder, is_intact, keep, writable_by_others
from heli_sim.compiled import compile_source, compiler
from heli_sim.errors import PlantError

SOURCE = "double tiny(void) { return 1.5; }\n"

needs_compiler = pytest.mark.skipif(compiler() is None, reason="skipped: no C compiler")
posix = pytest.mark.skipif(os.name != "posix", reason="skipped: owners and modes are POSIX")


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A cache of its own for every test."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "heli_sim"


def build() -> Path:
    library = compile_source("tiny", SOURCE)
    assert library is not None
    return library


@needs_compiler
@pytest.mark.medium
def test_a_library_that_a_power_cut_damaged_is_built_again() -> None:
    library = build()
    complete = library.read_bytes()
    for damaged in (
        b"",
        complete[:700],
        complete[: len(complete) // 2],
        complete[:-1],
        bytes(len(complete)),
        complete[:-2000],
    ):
        library.write_bytes(damaged)
        assert not is_intact(library)
        assert build() == library and is_intact(library)
    # In a process of its own: a library cut short can end the one that loads it.
    script = f"import ctypes; f = ctypes.CDLL({str(library)!r}).tiny; f.restype = ctypes.c_double; print(f())"
    assert subprocess.check_output([sys.executable, "-c", script], text=True).strip() == "1.5"


@needs_compiler
@pytest.mark.medium
def test_a_whole_library_is_not_built_again(monkeypatch: pytest.MonkeyPatch) -> None:
    library = build()
    monkeypatch.setattr(subprocess, "run", pytest.fail)
    assert build() == library


@needs_compiler
@pytest.mark.medium
def test_a_library_of_a_version_without_digests_is_built_again() -> None:
    library = build()
    library.write_bytes(library.read_bytes().partition(b"\nheli_sim sha256 ")[0])
    ctypes.CDLL(str(library))
    assert not is_intact(library)
    assert is_intact(build())


def test_a_library_is_on_the_disk_before_it_has_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    built, library = tmp_path / "f.so", tmp_path / "a.so"
    built.write_bytes(b"code")
    synced: list[tuple[int, bool]] = []

    def sync(descriptor: int) -> None:
        synced.append((os.fstat(descriptor).st_size, library.exists()))

    monkeypatch.setattr("heli_sim.cache.os.fsync", sync)
    keep(built, library)
    assert synced == [(library.stat().st_size, False)]
    assert is_intact(library) and not built.exists()


@posix
@pytest.mark.parametrize("mode", [0o777, 0o775, 0o1777])
def test_a_cache_that_others_can_write_is_refused(folder: Path, mode: int) -> None:
    folder.mkdir()
    folder.chmod(mode)
    with pytest.raises(PlantError, match=r"others can write to the cache .*; check .* remove it with: rm -r"):
        cache_folder()


@posix
def test_a_cache_is_made_for_its_user_alone(folder: Path) -> None:
    before = os.umask(0)
    try:
        assert cache_folder() == folder
    finally:
        os.umask(before)
    assert folder.stat().st_mode & 0o077 == 0 and writable_by_others(folder) == ""


@posix
def test_a_library_that_others_can_write_is_not_loaded(folder: Path) -> None:
    folder.mkdir()
    built, library = folder / "f.so", folder / "a.so"
    built.write_bytes(b"code")
    keep(built, library)
    assert is_intact(library)
    library.chmod(0o666)
    assert not is_intact(library)


@posix
def test_a_cache_of_another_user_is_reported(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder.mkdir()
    monkeypatch.setattr("heli_sim.cache.os.geteuid", lambda: folder.stat().st_uid + 1)
    if folder.stat().st_uid != 0:
        assert "belongs to another user" in writable_by_others(folder)
        return
    os.chown(folder, 12345, -1)
    assert "belongs to another user" in writable_by_others(folder)

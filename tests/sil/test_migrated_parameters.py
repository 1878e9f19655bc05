"""A board whose parameters were saved under another schema says at connect what became of them."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import heli_host
import pytest
from heli_host.board.parameters import read_origin
from heli_host.declaration import PARAMS, PARAMS_HASH, ParamsSource
from heli_host.ui.cli.board import open_board
from heli_sim.sil.flash_pages import saved

PAGE_BYTES = 512


@pytest.fixture
def flash(tmp_path: Path) -> Path:
    """Flash in which hover_V was saved as 1.75, under another schema that had no parameter `controller`."""
    content = bytearray(saved({"hover_V": 1.75}))
    for start in (0, PAGE_BYTES):
        content[start + 3] = len(PARAMS) - 1
        content[start + 4 : start + 8] = struct.pack("<I", PARAMS_HASH ^ 1)
        crc = zlib.crc32(content[start : start + PAGE_BYTES - 4])
        content[start + PAGE_BYTES - 4 : start + PAGE_BYTES] = struct.pack("<I", crc)
    file = tmp_path / "flash.bin"
    file.write_bytes(content)
    return file


def test_the_host_learns_what_was_kept_and_what_is_new(flash: Path) -> None:
    with heli_host.connect(f"sil://?flash={flash}") as heli:
        assert heli.params["hover_V"] == 1.75
        origin = read_origin(heli.session)
        assert (origin.source, origin.kept, origin.dropped) == (ParamsSource.MIGRATED, len(PARAMS) - 1, 0)
        assert origin.new == (PARAMS[-1].name,)
        heli.params.save()
        assert read_origin(heli.session).source is ParamsSource.STORED
    with heli_host.connect(f"sil://?flash={flash}") as heli:
        assert heli.info.params_source == "stored"


def test_the_command_line_warns_at_connect(flash: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with open_board(None, f"sil://?flash={flash}"):
        pass
    output = "".join(capsys.readouterr())
    assert f"{len(PARAMS) - 1} kept, {PARAMS[-1].name} at the default, 0 dropped" in output

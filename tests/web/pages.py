"""The page as one file with all that it offers and a short plan, for every test that opens it."""

import importlib.util
from collections.abc import Sequence
from pathlib import Path

import pytest
from heli_host.board.law_program import LawProgram
from heli_host.fly.plan import plan_names
from heli_web.build import write_page
from heli_web.compiler import built_board

from tests.page.page_server import SHORT_PLAN


def board_module() -> Path:
    """The module of the boards; compiled in a minute if the sources are new."""
    if importlib.util.find_spec("ziglang") is None:
        pytest.skip("skipped: no compiler for WebAssembly: make setup")
    return built_board(print)


def write_whole_page(folder: Path, laws: Sequence[LawProgram] = ()) -> Path:
    """Write the page into a folder."""
    board_module()
    short, output = folder / "short.toml", folder / "heli-lab.html"
    short.write_text(SHORT_PLAN)
    write_page(output, [str(short), *plan_names()], None, [], laws=laws)
    return output

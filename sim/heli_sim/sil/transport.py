"""The entry point through which hosts reach a simulated board by its ``sil://`` address."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from urllib.parse import parse_qsl, urlsplit

from heli_host.errors import LinkLost
from heli_host.link.transport import SerialTransport
from typing_extensions import override

from heli_sim.rig import load_rig
from heli_sim.rig.board import parameters_of, set_from_rig_text
from heli_sim.sil.boards import choose
from heli_sim.sil.inprocess import InProcessTransport
from heli_sim.sil.options import parse_url
from heli_sim.sil.process import SilProcess
from heli_sim.sil.recipe import recipe_of
from heli_sim.sil.world import SilWorld, set_from_rig


class ProcessTransport(SerialTransport):
    """Transport to a simulated board in a separate process, behind a pseudo-terminal."""

    def __init__(
        self,
        process: SilProcess,
        label: str,
        note: str = "",
        rig: str = "",
        rig_parameters: Mapping[str, float] = MappingProxyType({}),
        recipe: Mapping[str, str] = MappingProxyType({}),
    ) -> None:
        super().__init__(process.url)
        self.recipe = recipe
        self.rig_parameters = rig_parameters
        self.label = label
        self.note = note
        self.rig = rig
        self._process = process
        self._lost = False

    @override
    def read(self, timeout_s: float) -> bytes:
        try:
            return super().read(timeout_s)
        except LinkLost:
            self._lost = True
            raise

    @override
    def write(self, data: bytes) -> None:
        try:
            super().write(data)
        except LinkLost:
            self._lost = True
            raise

    @override
    def close(self) -> None:
        super().close()
        if not self._lost:
            self._process.stop()

    @override
    def reopen(self) -> ProcessTransport:
        return ProcessTransport(
            self._process, self.label, self.note, self.rig, self.rig_parameters, self.recipe
        )


def open_transport(url: str) -> InProcessTransport | ProcessTransport:
    """Start a simulated board and open its port; the entry point ``heli_host.transports``, name ``sil``. The
    board is just powered up, with the arm at rest on the table.
    """
    options = parse_url(url)
    choice = choose(options.board, options.elf)
    no_due = f"no emulated Due: {choice.reason}" if choice.reason else ""
    if options.process:
        values = dict(parse_qsl(urlsplit(url).query))
        values |= {"board": choice.name, "elf": choice.elf, "process": "0"}
        rig = load_rig(options.rig)
        note = _joined_texts(no_due, set_from_rig_text(rig.name, set_from_rig(options, rig)))
        return ProcessTransport(
            SilProcess(options=values),
            choice.text,
            note,
            options.rig,
            parameters_of(rig) | options.rig_faults.uncompared_signs,
            recipe_of(url, options, rig, choice),
        )
    world = SilWorld(replace(options, board=choice.name, elf=choice.elf))
    note = _joined_texts(no_due, set_from_rig_text(world.rig.name, world.set_from_rig))
    recipe = recipe_of(url, options, world.rig, choice)
    return InProcessTransport(world, url, choice.text, note, recipe)


def _joined_texts(*texts: str) -> str:
    return "; ".join(filter(None, texts))

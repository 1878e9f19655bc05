"""The board's parameters as pages see and change them, with the way back."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from heli_host.errors import HeliError, ParameterError
from heli_host.ui.page.source import number, text

if TYPE_CHECKING:
    from heli_host.fly.heli import Heli
    from heli_host.ui.page.recording import Recording

_MAX_UNDO = 100


class ParameterEdits:
    """Changes of parameters by the clients of a `Cockpit`.

    It owns the values that pages show, and the changes that can be undone. Its requests run in the thread of
    `CommandQueue.QUICK`; `values` and `undoable` may be read from any thread.
    """

    def __init__(self, heli: Heli, recording: Recording, on_change: Callable[[], None]) -> None:
        self.values = dict(heli.params)
        self._heli = heli
        self._recording = recording
        self._on_change = on_change
        self._undo: list[tuple[str, float]] = []

    @property
    def undoable(self) -> int:
        """Number of changes that can be undone."""
        return len(self._undo)

    def set(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        """Run the request ``set``: change one parameter of the board."""
        name = text(arguments, "name")
        before = self._heli.params[name]
        self._heli.params.set(name, number(arguments, "value"))
        self._undo = [*self._undo, (name, before)][-_MAX_UNDO:]
        self._recording.announce("parameter", f"{name}: {before:g} -> {self._heli.params[name]:g}")
        self._note_change()
        return {"value": self._heli.params[name]}

    def undo_last(self, _: Mapping[str, Any]) -> Mapping[str, Any]:
        """Run the request ``undo``: take back the last change."""
        if not self._undo:
            raise ParameterError("this page has not changed any parameter", "change a parameter first")
        name, before = self._undo[-1]
        self._heli.params.set(name, before)
        self._undo.pop()
        self._recording.announce("parameter", f"{name}: back to {before:g}")
        self._note_change()
        return {"name": name, "value": before}

    def save(self, _: Mapping[str, Any]) -> Mapping[str, Any]:
        """Run the request ``save``: write the parameters into the board's flash."""
        return {"generation": self._heli.params.save()}

    def _note_change(self) -> None:
        with contextlib.suppress(HeliError):
            self.values = dict(self._heli.params)
        self._on_change()

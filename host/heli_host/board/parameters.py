"""The board's parameters, by name."""

from __future__ import annotations

import contextlib
import difflib
import math
from collections.abc import Iterator, Mapping

import numpy as np

from heli_host.declaration import (
    PARAMS,
    Param,
    ParamsDefaultMessage,
    ParamSetMessage,
    ParamSpec,
    ParamsSaveMessage,
    Result,
)
from heli_host.errors import CommandRefused, HeliError, LinkError, ParameterError, range_text
from heli_host.link.events import BOARD_RESTARTED, LinkEvent
from heli_host.link.session import Session

_INDEX = {spec.name: spec.index for spec in PARAMS}


class Parameters(Mapping[str, float]):
    """The parameters in force on the board, read once and then updated with each change.

    ``heli.params["hover_V"]`` reads, ``heli.params["hover_V"] = 1.5`` sets, and ``save`` stores all values,
    so that they survive a restart of the board.
    """

    def __init__(self, session: Session) -> None:
        self._session = session
        self.revision = 0
        self._values: list[float] = []
        self._stale = True
        session.subscribe_events(self._take_event)

    def __getitem__(self, name: str) -> float:
        index = spec_of(name).index
        if self._stale:
            self.refresh()
        return self._values[index]

    def __setitem__(self, name: str, value: float) -> None:
        self.set(name, value)

    def __iter__(self) -> Iterator[str]:
        return iter(_INDEX)

    def __len__(self) -> int:
        return len(PARAMS)

    def refresh(self) -> None:
        """Read all parameters from the board again."""
        self._values = [shortest_decimal(value) for value in self._session.read_params()]
        self._stale = False
        self.revision += 1

    def spec(self, name: str) -> ParamSpec:
        """Return the declaration of a parameter: unit, range, default, meaning."""
        return spec_of(name)

    def set(self, name: str, value: float) -> float:
        """Set a parameter in the board's memory, and return the value in force, rounded to single
        precision.
        """
        spec = checked(name, value)
        try:
            ack = self._session.command(ParamSetMessage(0, spec.index, value))
        except CommandRefused as error:
            if error.result == Result.OUT_OF_RANGE:
                # The value is in the declared range, but this board was built with a smaller range.
                raise ParameterError(
                    f"the board refused {name} = {value:g}",
                    f"heli-host params list {name} --long shows the values that this board takes",
                ) from error
            raise
        in_force = shortest_decimal(ack.value)
        if not self._stale:
            self._values[spec.index] = in_force
            self.revision += 1
        return in_force

    def save(self) -> int:
        """Write all parameters to the board's flash, so that they outlast a restart; only while idle. Returns
        the generation of the stored set.
        """
        return round(self._session.command(ParamsSaveMessage(0)).value)

    def defaults(self) -> None:
        """Put the declared defaults into the board's memory; only while idle; does not save."""
        self._session.command(ParamsDefaultMessage(0))
        self.refresh()

    def dump(self) -> dict[str, float]:
        """Return all parameters by name, in the declaration's order."""
        self.refresh()
        return dict(self)

    def restore(self, values: Mapping[str, float]) -> dict[str, float]:
        """Set several parameters, and return those that changed, with their new values.

        If the board refuses one value, none is changed.
        """
        for name, value in values.items():
            checked(name, value)
        before = self.dump()
        changed: dict[str, float] = {}
        for name, value in values.items():
            if shortest_decimal(value) == before[name]:
                continue
            try:
                changed[name] = self.set(name, value)
            except HeliError:
                with contextlib.suppress(LinkError):
                    for changed_name in changed:
                        self.set(changed_name, before[changed_name])
                raise
        return changed

    def _take_event(self, event: LinkEvent) -> None:
        if event.kind == BOARD_RESTARTED:
            self._stale = True


def spec_of(name: str) -> ParamSpec:
    """Return the declaration of a parameter."""
    if name not in _INDEX:
        similar = difflib.get_close_matches(name, _INDEX, 3)
        hint = f"did you mean {' or '.join(similar)}?" if similar else "heli-host params list shows all"
        raise ParameterError(f"unknown parameter {name}", hint)
    return PARAMS[_INDEX[name]]


def checked(name: str, value: float) -> ParamSpec:
    """Check a value against the declaration; return the parameter's row of the table."""
    spec = spec_of(name)
    is_in_range = (
        math.isfinite(value)
        and spec.min <= value <= spec.max
        and not (spec.nonzero and value == 0.0)
        and not (spec.integer and value != round(value))
    )
    if not is_in_range:
        raise ParameterError(f"{name} = {value:g} is out of range", f"give {_range(spec)}")
    return spec


def _range(spec: ParamSpec) -> str:
    return range_text(Param(spec.index))


def shortest_decimal(value: float) -> float:
    """Return the shortest decimal number that equals `value` in single precision: 0.35, not 0.349999994."""
    return float(str(np.float32(value)))

"""The control law that a page has chosen: the board's own cascade, or one of the given programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from heli_host.declaration import Channel, Flags, LawFlyMessage, LawState, State
from heli_host.errors import BadLaw, ParameterError, SetpointError
from heli_host.fly.guest_law import engage, loaded, set_parameter, takeover_text

if TYPE_CHECKING:
    from heli_host.board.law_program import LawProgram
    from heli_host.fly.heli import Heli
    from heli_host.link.events import LinkEvent

_EXPECTED_ENDS = ("command", "state")
"""Reasons for the end of a law's flight that a page does not report: a command, or the landing."""


class LawChoice:
    """The control laws that clients may choose, and the chosen one.

    A law is uploaded while the board is idle. It flies from the end of the take-off. In flight a client can
    switch only between the uploaded law and the board's own cascade, which runs along and takes over when the
    law fails.
    """

    def __init__(self, heli: Heli, laws: Sequence[LawProgram]) -> None:
        self.chosen = ""
        self._heli = heli
        self._laws = {law.name: law for law in laws}
        self._values = {law.name: dict(law.parameters) for law in laws}
        self._taken_over = ""
        if len(self._laws) < len(laws):
            names = ", ".join(law.name for law in laws)
            raise BadLaw(f"two control laws have the same name: {names}", "give one of them another name=")

    def describe(self) -> list[dict[str, Any]]:
        """Return name, rate [Hz], cost [processor instructions per call] and signals of each law, as JSON."""
        return [
            {
                "name": law.name,
                "rate_Hz": law.rate_Hz,
                "cost": law.cost,
                "signals": list(law.signal_names),
            }
            for law in self._laws.values()
        ]

    def status(self) -> dict[str, Any] | None:
        """Return the chosen law, whether it flies, why the board took over, and its parameters, as JSON; None
        without laws.
        """
        if not self._laws:
            return None
        return {
            "chosen": self.chosen,
            "flies": self._is_law_flying,
            "taken_over": self._taken_over,
            "values": dict(self._values.get(self.chosen, {})),
        }

    def choose(self, name: str) -> Mapping[str, Any]:
        """Choose the law that flies: immediately if the board flies, otherwise from the next take-off on."""
        if name and name not in self._laws:
            choices = ", ".join(self._laws) or "none was named: heli-host dashboard --law FILE.py"
            raise ParameterError(f"unknown control law {name:.40}", f"choose from: {choices}")
        state = self._heli.state
        if not name:
            if self._is_law_flying:
                self._heli.session.command(LawFlyMessage(0, 0))
        elif state is State.IDLE:
            self._heli.load_law(self._laws[name])
        elif state is State.CLOSED_LOOP:
            self._change_in_flight(name)
        else:
            raise SetpointError(f"no control law can start while the board is {state}", "land first")
        self.chosen, self._taken_over = name, ""
        return {"law": name}

    def set(self, name: str, value: float) -> tuple[float, float]:
        """Change a parameter of the chosen law on the board, also in flight."""
        if not self.chosen:
            raise ParameterError(
                "no control law is chosen",
                "change the gains of the board's own law among its parameters, or choose a law",
            )
        after = set_parameter(self._heli.session, self._laws[self.chosen], name, value)
        before = self._values[self.chosen].get(name, after)
        self._values[self.chosen][name] = after
        return before, after

    def engage(self) -> None:
        """Hand control from the board's own law to the chosen law, if there is one. The board must hover."""
        self._taken_over = ""
        if self.chosen:
            self._start_law(self.chosen)

    def take_event(self, event: LinkEvent) -> None:
        """Record why the board's own law took over, if the event says so."""
        takeover = takeover_text(event)
        if takeover is not None and takeover[0] not in _EXPECTED_ENDS:
            self._taken_over = f"{takeover[0].replace('_', ' ')} ({takeover[1]:.3g})"

    @property
    def _is_law_flying(self) -> bool:
        newest = self._heli.session.latest
        return newest is not None and bool(int(newest[1][Channel.FLAGS]) & Flags.LAW)

    def _change_in_flight(self, name: str) -> None:
        """Start the control law that the board already holds; in the air the board accepts no other law."""
        board_law = loaded(self._heli.session)
        if board_law.hash != self._laws[name].hash or board_law.state not in (
            LawState.READY,
            LawState.FLYING,
        ):
            raise SetpointError(
                f"the board has no control law {name}, and accepts one only on the table", "land first"
            )
        if not self._is_law_flying:
            self._start_law(name)

    def _start_law(self, name: str) -> None:
        """Start a law on the board, with the parameters that clients have changed."""
        law = self._laws[name]
        declared = dict(law.parameters)
        changed = {key: value for key, value in self._values[name].items() if value != declared[key]}
        engage(self._heli, law, changed)

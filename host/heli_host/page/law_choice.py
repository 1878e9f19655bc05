"""Which law flies a page's board: its own cascade, or one of those that were named."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from heli_host.declaration import Channel, Flags, LawFlyMessage, LawState, State
from heli_host.errors import BadLaw, ParameterError, SetpointError
from heli_host.guest_law import engage, loaded, set_parameter, takeover_text

if TYPE_CHECKING:
    from heli_host.heli import Heli
    from heli_host.link.events import LinkEvent
    from heli_host.tape import Tape

_AS_WISHED = ("command", "state")
"""Ends of a law's flight that need no word: it was asked for, or it landed."""


class LawChoice:
    """The laws that may be chosen, and which is.

    A law is brought to the board while that is idle, and flies from the end of the take-off on; in flight
    only the one that is there, or the cascade, can be chosen.

    Parameters
    ----------
    heli : Heli
        Connected.
    laws : sequence of Tape
        What there is to choose from besides the board's own.

    Attributes
    ----------
    chosen : str
        Name of the law; empty for the board's own.

    Raises
    ------
    BadLaw
        Two have the same name.
    """

    def __init__(self, heli: Heli, laws: Sequence[Tape]) -> None:
        self.chosen = ""
        self._heli = heli
        self._laws = {law.name: law for law in laws}
        self._values = {law.name: dict(law.parameters) for law in laws}
        self._taken_over = ""
        if len(self._laws) < len(laws):
            names = ", ".join(law.name for law in laws)
            raise BadLaw(f"two control laws have the same name: {names}", "give one of them another name=")

    def describe(self) -> list[dict[str, Any]]:
        """Return what a page needs to know of each, as JSON."""
        return [
            {
                "name": law.name,
                "rate_Hz": law.rate_Hz,
                "cost": law.cost,
                "signals": list(law.told),
            }
            for law in self._laws.values()
        ]

    def status(self) -> dict[str, Any] | None:
        """Return what a page shows of it, as JSON; None where there is nothing to choose."""
        if not self._laws:
            return None
        return {
            "chosen": self.chosen,
            "flies": self._flies,
            "taken_over": self._taken_over,
            "values": dict(self._values.get(self.chosen, {})),
        }

    def choose(self, name: str) -> Mapping[str, Any]:
        """Have a law fly: at once in the air, else from the next take-off on.

        Parameters
        ----------
        name : str
            Of the law; empty for the board's own.

        Raises
        ------
        ParameterError
            There is no such law.
        SetpointError
            It cannot be chosen now.
        CommandRefused
            The board does not take it, and says why.
        FlightAborted
            It was taken over at once.
        """
        if name and name not in self._laws:
            known = ", ".join(self._laws) or "none was named: heli-host dashboard --law FILE.py"
            raise ParameterError(f"unknown control law {name:.40}", f"choose from: {known}")
        state = self._heli.state
        if not name:
            if self._flies:
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
        """Change a parameter of the law that is chosen, in flight too; returns the values before and after.

        Parameters
        ----------
        name : str
            Of the parameter.
        value : float
            Its new value; kept until the page's server ends.

        Raises
        ------
        ParameterError
            The board's own law is chosen.
        BadLaw
            The law has no such parameter.
        CommandRefused
            The board has forgotten the law.
        """
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
        """Have the law that is chosen fly, if one is; the board hovers under its own.

        Raises
        ------
        CommandRefused
            The board does not take it.
        FlightAborted
            It was taken over at once.
        """
        self._taken_over = ""
        if self.chosen:
            self._engage(self.chosen)

    def take_event(self, event: LinkEvent) -> None:
        """Note why the board's own law took over.

        Parameters
        ----------
        event : LinkEvent
            Any.
        """
        told = takeover_text(event)
        if told is not None and told[0] not in _AS_WISHED:
            self._taken_over = f"{told[0].replace('_', ' ')} ({told[1]:.3g})"

    @property
    def _flies(self) -> bool:
        newest = self._heli.session.latest
        return newest is not None and bool(int(newest[1][Channel.FLAGS]) & Flags.LAW)

    def _change_in_flight(self, name: str) -> None:
        has = loaded(self._heli.session)
        if has.hash != self._laws[name].hash or has.state not in (LawState.READY, LawState.FLYING):
            raise SetpointError(
                f"the board has no control law {name}, and accepts one only on the table", "land first"
            )
        if not self._flies:
            self._engage(name)

    def _engage(self, name: str) -> None:
        law = self._laws[name]
        own = dict(law.parameters)
        engage(self._heli, law, {key: one for key, one in self._values[name].items() if one != own[key]})

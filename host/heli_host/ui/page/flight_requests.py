"""Requests of a page that move the rig, and the flight that is in progress."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from heli_host.declaration import Axes, State
from heli_host.errors import LinkError, ParameterError, SetpointError
from heli_host.ui.page.flying import PlanFlight
from heli_host.ui.page.source import number

if TYPE_CHECKING:
    from heli_host.fly.heli import Heli
    from heli_host.fly.plan import Plan
    from heli_host.ui.page.law_choice import LawChoice
    from heli_host.ui.page.pilot_watch import PilotWatch
    from heli_host.ui.page.recording import Recording


class FlightRequests:
    """Requests of the pilot of a `Cockpit`: take off, fly plans, move, land.

    It owns the flight of plans that is in progress. `take_off` and `fly` block in the thread of
    `CommandQueue.FLIGHT`, until the arm hovers or the motors are off. Meanwhile the others run in the threads
    of `CommandQueue.QUICK` and `CommandQueue.SETPOINT`. The stop is no request: `Cockpit.stop` sends it past
    all queues, and the board's change of state then ends the flight here.
    """

    def __init__(
        self, heli: Heli, plans: Sequence[Plan], law: LawChoice, recording: Recording, pilot: PilotWatch
    ) -> None:
        self.plans = {plan.name: plan for plan in plans}
        self.doing = ""
        self._heli = heli
        self._law = law
        self._recording = recording
        self._pilot = pilot
        self._flight: PlanFlight | None = None

    @property
    def flies_plan(self) -> bool:
        """Whether plans fly now. It may be read from any thread."""
        return self._flight is not None

    @property
    def progress(self) -> dict[str, Any] | None:
        """Progress of the plans that fly now, as JSON; None without any. It may be read from any thread."""
        flight = self._flight
        return flight.progress if flight is not None else None

    def take_off(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        """Run the request ``take_off``: rise to a level hover, then hand over to the chosen law."""
        elevation_deg = number(arguments, "elevation_deg") if "elevation_deg" in arguments else 0.0
        with self._shown_as_busy("taking off"):
            self._heli.take_off(elevation_deg)
            self._law.engage()
        return {}

    def fly(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        """Run the request ``fly``: take off, fly plans, land. It returns when the motors are off."""
        plans = arguments.get("plans")
        names = [str(name) for name in (plans if isinstance(plans, list) else [plans])]
        if not names:
            raise ParameterError("no plan is named", f"choose from {', '.join(self.plans)}")
        for name in names:
            if name not in self.plans:
                known = ", ".join(self.plans)
                raise ParameterError(f"unknown plan {name:.40}", f"choose from {known}")
        if self._heli.state is not State.IDLE:
            raise SetpointError("a plan starts only from the table, with the motors off", "land first")
        plans = [self.plans[name] for name in names]
        flight = PlanFlight(self._heli, plans, self._law.engage)
        begins_recording = self._recording.recorder is None
        if begins_recording:
            self._recording.begin(plans, flight.duration_s)
        recorder = self._recording.recorder
        if recorder is None:
            raise LinkError("the recording ended before the plan started", "start it again")
        self._flight = flight
        try:
            with self._shown_as_busy(f"flying {', '.join(names)}"):
                outcome = flight.fly(recorder)
        finally:
            self._flight = None
            if begins_recording:
                self._recording.close(flight.outcome)
        return {"outcome": self._pilot.outcome_in_words(outcome)}

    def land(self, _: Mapping[str, Any]) -> Mapping[str, Any]:
        """Run the request ``land``: descend; it also ends plans that fly."""
        self._heli.land(wait=False)
        return {}

    def clear_fault(self, _: Mapping[str, Any]) -> Mapping[str, Any]:
        """Run the request ``clear_fault``: leave the fault; the motors stay off."""
        self._heli.clear_fault()
        return {}

    def zero(self, _: Mapping[str, Any]) -> Mapping[str, Any]:
        """Run the request ``zero``: take the present angles as the zeros of the encoders."""
        self._heli.zero(Axes.ELEVATION | Axes.PITCH | Axes.TRAVEL)
        return {}

    def setpoint(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        """Run the request ``setpoint``: move, unless plans fly."""
        self._check_no_plan()
        axes = ("elevation_deg", "travel_deg")
        self._heli.setpoint(**{name: number(arguments, name) for name in axes if name in arguments})
        return {}

    def hold(self, _: Mapping[str, Any]) -> Mapping[str, Any]:
        """Run the request ``hold``: stay at the present angles, unless plans fly."""
        self._check_no_plan()
        self._heli.hold()
        return {}

    def _check_no_plan(self) -> None:
        if self._flight is not None:
            raise SetpointError("a plan flies now, and controls the setpoints", "end it with Land")

    @contextlib.contextmanager
    def _shown_as_busy(self, doing: str) -> Iterator[None]:
        """Show clients which request is in progress while the block runs."""
        self.doing = doing
        try:
            yield
        finally:
            self.doing = ""

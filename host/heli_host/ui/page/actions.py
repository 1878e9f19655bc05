"""The actions that clients request of a connected board: fly, choose a law, edit parameters, record."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from heli_host.board.law_flight import engage, loaded, set_parameter, takeover_reason
from heli_host.declaration import AXES, Axes, Channel, Flags, LawFlyMessage, LawState, State
from heli_host.errors import BadLaw, HeliError, LinkError, ParameterError, SetpointError
from heli_host.fly.pilot import Pilot, Progress
from heli_host.fly.plan import Plan, take_off
from heli_host.fly.tracking import Tolerance
from heli_host.link.clock import TICK_S
from heli_host.link.engine import UNNUMBERED
from heli_host.ui.page.source import News, cause, in_words, is_without_setpoints, number, text

if TYPE_CHECKING:
    from heli_host.board.heli import Heli
    from heli_host.board.law_program import LawProgram
    from heli_host.fly.plan import Plan
    from heli_host.fly.recorder import Recorder
    from heli_host.link.events import LinkEvent
    from heli_host.link.session import Session

_EXPECTED_ENDS = ("command", "state")
"""Reasons for the end of a law's flight that a page does not report: a command, or the landing."""
_MAX_UNDO = 100
_EVENTS_KEPT = 200
_LOOK_S = 0.2
_SETTLED_LOOKS = 15
"""Number of successive checks at which the pilot's page must be present before plans begin. A page that still
loads may not answer for a second."""


class FlightRequests:
    """Requests of the pilot of a `Cockpit`: take off, fly plans, move, land."""

    # It owns the flight of plans that is in progress. `take_off` and `fly` block in the thread of
    # `CommandQueue.FLIGHT`, until the arm hovers or the motors are off. Meanwhile the others run in the
    # threads of `CommandQueue.QUICK` and `CommandQueue.SETPOINT`. The stop is no request: `Cockpit.stop`
    # sends it past all queues, and the board's change of state then ends the flight here.

    def __init__(
        self, heli: Heli, plans: Sequence[Plan], law: LawChoice, recording: Recording, pilot: PilotWatch
    ) -> None:
        self.plans = {plan.name: plan for plan in plans}
        self.doing = ""
        self._heli = heli
        self._law = law
        self._recording = recording
        self._pilot = pilot
        self._flight: _PlanFlight | None = None

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
        requested = arguments.get("plans")
        names = [str(name) for name in (requested if isinstance(requested, list) else [requested])]
        if not names:
            raise ParameterError("no plan is named", f"choose from {', '.join(self.plans)}")
        for name in names:
            if name not in self.plans:
                known = ", ".join(self.plans)
                raise ParameterError(f"unknown plan {name:.40}", f"choose from {known}")
        if self._heli.state is not State.IDLE:
            raise SetpointError("a plan starts only from the table, with the motors off", "land first")
        plans = [self.plans[name] for name in names]
        flight = _PlanFlight(self._heli, plans, self._law.engage)
        # A recording that the pilot has begun goes on after the flight.
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


class _PlanFlight:
    """Plans that were checked against a board and can be flown once."""

    def __init__(
        self, heli: Heli, plans: Sequence[Plan], on_taken_off: Callable[[], object] | None = None
    ) -> None:
        sample = heli.latest
        start_deg = np.degrees([getattr(sample, f"{axis}_rad") for axis in AXES])
        self._heli, self._plans, self._on_taken_off = heli, plans, on_taken_off
        self._route = take_off(plans, dict(heli.params), start_deg)
        self.duration_s = self._route.duration_s
        self.outcome = "not flown"
        self.progress: dict[str, Any] = {"phase": "take-off", "t_s": 0.0, "left_s": self.duration_s}

    def fly(self, recorder: Recorder) -> str:
        """Take off, fly the plans, land, and return the outcome. Blocks until the motors are off."""
        tolerance = Tolerance.widest([plan.tolerance for plan in self._plans])
        pilot = Pilot(
            heli=self._heli,
            route=self._route,
            axes=self._plans[0].axes,
            recorder=recorder,
            on_progress=self._store_progress,
            tolerance=tolerance,
            on_taken_off=self._on_taken_off,
        )
        try:
            pilot.fly()
        finally:
            self.outcome = pilot.outcome
        return self.outcome

    def _store_progress(self, progress: Progress) -> None:
        left_s = None if progress.left_s is None else round(max(progress.left_s, 0.0), 1)
        self.progress = {"phase": progress.phase, "t_s": round(progress.t_s, 1), "left_s": left_s}


class LawChoice:
    """The control laws that clients may choose, and the chosen one."""

    # A law is uploaded while the board is idle. It flies from the end of the take-off. In flight a client can
    # switch only between the uploaded law and the board's own cascade, which runs along and takes over when
    # the law fails.

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
            {"name": law.name, "rate_Hz": law.rate_Hz, "cost": law.cost, "signals": list(law.signal_names)}
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
                self._heli.session.command(LawFlyMessage(UNNUMBERED, on=0))
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
        takeover = takeover_reason(event)
        if takeover is not None and takeover.name not in _EXPECTED_ENDS:
            self._taken_over = f"{takeover.name.replace('_', ' ')} ({takeover.value:.3g})"

    @property
    def _is_law_flying(self) -> bool:
        newest = self._heli.session.latest
        return newest is not None and bool(int(newest.raw[Channel.FLAGS]) & Flags.LAW)

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


class ParameterEdits:
    """Changes of parameters by the clients of a `Cockpit`."""

    # It owns the values that pages show, and the changes that can be undone. Its requests run in the thread
    # of `CommandQueue.QUICK`; `values` and `undoable` may be read from any thread.

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


class Recording:
    """The recorder of a `Cockpit`, while there is one."""

    # Its methods may be called from any thread.
    # It owns the recorder from `begin` to `close`. Nothing here moves the rig or stops it.

    def __init__(
        self, session: Session, new_recorder: Callable[[Sequence[Plan], float], Recorder], feed: EventFeed
    ) -> None:
        self._session = session
        self._new_recorder = new_recorder
        self._feed = feed
        self._recorder: Recorder | None = None
        self._marks = 0

    @property
    def recorder(self) -> Recorder | None:
        """The present recorder; None while nothing is recorded."""
        return self._recorder

    def status(self) -> dict[str, Any]:
        """Return the path of the log and the error of the recorder, as JSON."""
        recorder = self._recorder
        return {
            "recording": str(recorder.path) if recorder is not None else None,
            "trouble": str(recorder.error) if recorder is not None and recorder.error is not None else "",
        }

    def begin(self, plans: Sequence[Plan], duration_s: float) -> None:
        """Create a log file and begin to record."""
        self._recorder = self._new_recorder(plans, duration_s)
        self._feed.tell({"recording": str(self._recorder.path)})

    def close(self, outcome: str = "recorded") -> None:
        """End the recording, if there is one, and write the log to its end. The motors are not touched."""
        recorder, self._recorder = self._recorder, None
        if recorder is not None:
            recorder.close(outcome)
            self._feed.tell({"recorded": str(recorder.path)})

    def write(self, kind: str, words: str) -> None:
        """Write a line of the host's own into the log, if there is one."""
        recorder = self._recorder
        if recorder is not None:
            recorder.note(kind, words)

    def announce(self, kind: str, words: str) -> None:
        """Write a line into the log, and show it on all pages as an event."""
        self.write(kind, words)
        self._feed.add(self._newest_tick(), kind, words)

    def mark(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        """Run the request ``mark``: a line of a person's own, numbered if it has no text."""
        self._marks += 1
        words = text(arguments, "text") if arguments.get("text") else f"mark {self._marks}"
        self.announce("mark", words)
        return {"logged": self._recorder is not None}

    def signal(self, arguments: Mapping[str, Any]) -> Mapping[str, Any]:
        """Run the request ``signal``: a number of another program, for the log and for a strip on each
        page.
        """
        name, value = text(arguments, "name", 40), number(arguments, "value")
        tick = self._newest_tick()
        self.write("signal", f"{name} = {value!r}")
        self._feed.tell({"signal": {"name": name, "value": value, "tick": tick}})
        return {}

    def _newest_tick(self) -> int:
        newest = self._session.latest
        return newest.tick if newest is not None else 0


class EventFeed:
    """News of a `Cockpit` on its way to the pages."""

    # Its methods may be called from any thread.
    # It owns the newest events, which a page that connects later gets as well.

    def __init__(self) -> None:
        self._news: News | None = None
        self._events: list[dict[str, Any]] = []

    def listen(self, news: News) -> None:
        """Register the callback for news; see `heli_host.ui.page.source.Source.listen`."""
        self._news = news

    def tell(self, news: Mapping[str, Any]) -> None:
        """Send news to all pages."""
        if self._news is not None:
            self._news(news)

    def add(self, tick: int, kind: str, words: str) -> None:
        """Keep an event, and send it to all pages."""
        entry = {"t_s": round(tick * TICK_S, 3), "kind": kind, "text": words}
        self._events = [*self._events[1 - _EVENTS_KEPT :], entry]
        self.tell({"event": entry})

    def newest(self) -> list[dict[str, Any]]:
        """Return the newest events as JSON, oldest first."""
        return self._events[-_EVENTS_KEPT:]


class PilotWatch:
    """Presence of the pilot's page, and the cause of the board's last change of state."""

    # It owns the cause of the board's last change of state. The server's lease decides whether the page is
    # present. The session asks the same callable before each setpoint: see
    # `heli_host.link.session.Session.permit_streams`.

    def __init__(self, recording: Recording) -> None:
        self.cause = ""
        self._recording = recording
        self._present: Callable[[], bool] = lambda: False
        self._absence: Callable[[], str] = lambda: ""
        self._last_absence = ""

    def watch(self, present: Callable[[], bool], absence: Callable[[], str]) -> None:
        """Register the conditions; see `heli_host.ui.page.source.Source.watch_pilot`."""
        # `present`: True while the pilot's page answers; it must not block.
        self._present, self._absence = present, absence

    def wait_until_settled(self, give_up: Callable[[], bool]) -> bool:
        """Wait, in the caller's thread, until a pilot's page has answered for 3 s without a break."""
        looks = 0
        while looks < _SETTLED_LOOKS:
            if give_up():
                return False
            time.sleep(_LOOK_S)
            looks = looks + 1 if self._present() else 0
        return True

    def event_in_words(self, text: str) -> str:
        """Return the text of an event with its cause in words, and write an absent pilot into the log."""
        is_without = is_without_setpoints(text)
        absence = self._absence() if is_without else ""
        if absence and absence != self.cause:
            self._recording.write("pilot", absence)
        if is_without:
            self._last_absence = absence
        self.cause = cause(text, absence) or self.cause
        return in_words(text, absence)

    def outcome_in_words(self, outcome: str) -> str:
        """Return the outcome of a flight with its cause in words."""
        return in_words(outcome, self._last_absence)

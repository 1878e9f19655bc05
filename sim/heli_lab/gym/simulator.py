"""What an episode flies in: the plant alone, or the whole board in lockstep."""

from __future__ import annotations

import contextlib
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Protocol
from urllib.parse import urlencode

import casadi as ca
import heli_host
import numpy as np
from heli_host.arrays import Floats
from heli_host.declaration import State
from heli_host.errors import HeliError
from heli_sim.compiled import compile_function
from heli_sim.model.multibody import MultibodyModel
from heli_sim.model.named import model_named
from heli_sim.plant import Plant
from heli_sim.rig import write_rig
from heli_sim.sil.inprocess import InProcessTransport
from typing_extensions import override

from heli_lab.errors import LearningError
from heli_lab.gym.domain import Drawn

_BATCH_TICKS: Final = 4
"""Least telemetry batch that the board offers: what is seen is at most 4 ms old."""
_CARRIED_S, _CARRIED_STEPS = 0.5, 50
"""How long the arm is carried to where an episode begins: at 20 deg/s, far below rates that are a fault."""
_MOST_PLANTS: Final = 32
_SETTLING_STEPS, _SETTLING_TICKS = 20, 20
"""0.4 s in which thrusts that lag reach that of hover: seven times the longest lag seen on a rig."""


@dataclass(frozen=True)
class Seen:
    """What the encoders say at the end of a step.

    Parameters
    ----------
    angles_rad : ndarray (3,)
        Elevation, pitch and travel.
    flying : bool
        False once the arm is down, an axis is at its stop, or the board no longer takes voltages.
    why : str
        Why it no longer flies; empty while it does.
    """

    angles_rad: Floats
    flying: bool = True
    why: str = ""


class Simulator(Protocol):
    """What `HoverEnv` flies."""

    def reset(self, drawn: Drawn, state: Floats, hover_V: Floats, seed: int) -> Seen:
        """Begin with a rig in the air.

        Parameters
        ----------
        drawn : Drawn
            The rig and its effects.
        state : ndarray (6,)
            Angles [rad] and rates [rad/s] to begin with.
        hover_V : ndarray (2,)
            Voltages that acted until now [V].
        seed : int
            Seed of what effects leave to chance.
        """
        ...

    def step(self, volts_V: Floats, ticks: int) -> Seen:
        """Hold two voltages for some milliseconds.

        Parameters
        ----------
        volts_V : ndarray (2,)
            Front and back [V].
        ticks : int
            How long [ms].
        """
        ...

    def close(self) -> None:
        """Let go of what it holds."""
        ...


class PlantAlone(Simulator):
    """The equations with encoders, stops and table: as fast as can be, and no board in between."""

    def __init__(self) -> None:
        self._run: dict[object, ca.Function] = {}
        self._plants: dict[object, Plant] = {}

    @override
    def reset(self, drawn: Drawn, state: Floats, hover_V: Floats, seed: int) -> Seen:
        model = model_named(drawn.rig.model or MultibodyModel.name, drawn.effects)
        late = tuple(effect.values[effect.delay] for effect in drawn.effects if effect.delay)
        # What the compiled step depends on; all other numbers are its arguments.
        key = (model.name, tuple(effect.name for effect in model.effects), late)
        if key not in self._plants:
            if len(self._plants) >= _MOST_PLANTS:
                self._plants.clear()
                self._run.clear()
            self._plants[key] = Plant(model, drawn.rig, seed)
        plant = self._plants[key]
        self._key, self._plant = key, plant
        limits = plant.parameters[len(model.parameters) :].copy()
        for place, name in enumerate(("elevation_min", "elevation_max", "pitch_max", "travel_max")):
            limits[place] = drawn.rig[name].value
        limits[4] = drawn.rig["table_damping"].value
        self._parameters = np.array([*model.parameter_values(drawn.rig), *limits])
        self._limits_rad = np.deg2rad(limits[:4])
        counts = drawn.rig["encoder_counts"].value
        self._rad = 2.0 * np.pi / np.array([counts, counts, counts * drawn.rig["encoder_travel_ratio"].value])
        self._state = (
            Plant(model, drawn.rig, seed).rest_state() if plant.extras.random else plant.rest_state()
        )
        self._state[:6] = state
        # A thrust that lags must not begin at none.
        self._settle(hover_V)
        self._state[:6] = state
        return self._seen(self._state[:3])

    @override
    def step(self, volts_V: Floats, ticks: int) -> Seen:
        return self._seen(self._advance(np.asarray(volts_V, np.float64), ticks))

    @override
    def close(self) -> None:
        self._plants.clear()
        self._run.clear()

    def _settle(self, hover_V: Floats) -> None:
        kept = self._state[:6].copy()
        for _ in range(_SETTLING_STEPS):
            self._advance(hover_V, _SETTLING_TICKS)
            self._state[:6] = kept

    def _advance(self, volts_V: Floats, ticks: int) -> Floats:
        """Go on by so many milliseconds; the measured angles [rad]."""
        run = self._ticks(ticks)
        # CasADi reads and writes the arrays in place: its own matrices would take five times as long.
        buffer: Any
        buffer, evaluate = run.buffer()
        given: tuple[Any, ...] = (self._state, volts_V, self._parameters)
        after, measured = np.empty(self._state.size), np.empty(3)
        outputs: tuple[Any, ...] = (after, measured)
        for place, array in enumerate(given):
            buffer.set_arg(place, memoryview(array))
        for place, array in enumerate(outputs):
            buffer.set_res(place, memoryview(array))
        evaluate()
        self._state = after
        return measured

    def _ticks(self, ticks: int) -> ca.Function:
        """So many milliseconds in one call; without a C compiler CasADi's virtual machine does them."""
        key = (self._key, ticks)
        if key not in self._run:
            step = self._plant.function
            library = compile_function(step)
            if library is not None:
                step = ca.external(step.name(), str(library))
            x, u = ca.MX.sym("state", step.numel_in(0)), ca.MX.sym("volts_V", 2)
            p, after, measured = ca.MX.sym("parameters", step.numel_in(3)), x, ca.MX.zeros(3)
            for _ in range(ticks):
                after, measured = step(after, u, ca.MX.zeros(3), p)
            self._run[key] = ca.Function("ticks", [x, u, p], [after, measured])
        return self._run[key]

    def _seen(self, measured_rad: Floats) -> Seen:
        angles = np.round(measured_rad / self._rad) * self._rad
        low, high, pitch, travel = self._limits_rad
        elevation = self._state[0]
        why = (
            "the arm is on its table" if elevation <= low
            else "elevation is at its stop" if elevation >= high
            else "pitch is at its stop" if abs(self._state[1]) >= pitch
            else "travel is at its stop" if abs(self._state[2]) >= travel
            else ""
        )  # fmt: skip
        return Seen(angles, not why, why)


class BoardInLockstep(Simulator):
    """The flight code with its limits and faults, and the link, on simulated time; the board takes off by its
    own law, and then takes streamed voltages.
    """

    def __init__(self) -> None:
        self._heli: heli_host.Heli | None = None
        self._folder = tempfile.TemporaryDirectory(prefix="heli-gym-")

    @override
    def reset(self, drawn: Drawn, state: Floats, hover_V: Floats, seed: int) -> Seen:
        self._let_go()
        path = Path(self._folder.name) / "rig.toml"
        write_rig(drawn.rig, path)
        options = {"rig": str(path), "seed": str(seed), "slice_ms": "1"}
        if drawn.texts:
            options["effect"] = ";".join(drawn.texts)
        self._heli = heli = heli_host.connect(f"sil://?{urlencode(options)}", history_s=1.0)
        heli.take_off()
        heli.params["telemetry_batch_ticks"] = _BATCH_TICKS
        heli.session.read_interval_s = 0.001
        transport = heli.session.transport
        if not isinstance(transport, InProcessTransport):
            raise LearningError("the board is not in this process", "leave board=... out")
        heli.stream()
        world, volts_V = transport.world, self._allowed(hover_V)
        before = world.state
        # Carried there as by a hand, for the board takes a jump for an axis that runs away.
        for share in np.linspace(0.0, 1.0, _CARRIED_STEPS):
            carried = before + share * (np.array([*state, *before[6:]]) - before)
            world.state = np.array([*carried[:3], *state[3:], *world.state[6:]])
            heli.voltages(*volts_V)
            heli.wait(_CARRIED_S / _CARRIED_STEPS)
        return self._seen()

    @override
    def step(self, volts_V: Floats, ticks: int) -> Seen:
        heli = self._flown()
        try:
            heli.voltages(*self._allowed(volts_V), valid_s=ticks * 2e-3)
            heli.wait(ticks * 1e-3)
        except HeliError as error:
            return Seen(self._angles_rad(), False, error.cause)
        return self._seen()

    @override
    def close(self) -> None:
        self._let_go()
        self._folder.cleanup()

    def _flown(self) -> heli_host.Heli:
        if self._heli is None:
            raise LearningError("no episode has begun", "call reset first")
        return self._heli

    def _allowed(self, volts_V: Floats) -> tuple[float, float]:
        params = self._flown().params
        front_V, back_V = np.clip(volts_V, params["motor_min_V"], params["motor_max_V"]).tolist()
        return front_V, back_V

    def _angles_rad(self) -> Floats:
        newest = self._flown().latest
        return np.array([newest.elevation_rad, newest.pitch_rad, newest.travel_rad])

    def _seen(self) -> Seen:
        newest = self._flown().latest
        flying = newest.state is State.STREAMED
        why = "" if flying else f"the board is in {newest.state}, fault {newest.fault}"
        return Seen(self._angles_rad(), flying, why)

    def _let_go(self) -> None:
        if self._heli is not None:
            with contextlib.suppress(HeliError):
                self._heli.close()
            self._heli = None

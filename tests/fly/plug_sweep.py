"""Plugs that return, counts that jump, encoders that stay dead, and wrong signs: what the arm truly did.

``python -m tests.fly.plug_sweep`` flies them and prints tables of docs/validation/faults.md. `fault_sweep`
measures how soon a dead encoder is noticed.
"""

import argparse
import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from heli_host.board.samples import Samples
from heli_host.declaration import AXES, State
from heli_host.fly.connection import connect
from heli_host.fly.runner import fly
from heli_sim.errors import SimError
from heli_sim.rig import Rig, load_rig, write_rig
from heli_sim.rig.schema import ENCODER_COUNTS

from tests.fly.fault_sweep import PLANS
from tests.fly.fault_table import WIRINGS
from tests.sil.harness import turn_unseen, world_of

WRONG_DEG: Final = 2.0
"""A completed flight must not end with a larger error of a reading that any encoder could have shown."""
DROP_DEG: Final = 6.0
"""Without the elevation encoder, the arm may fall this far when the motors end."""
_SETTLES_S: Final = 1.5
_SWINGS_S: Final = 6.0
_JUMPS_DEG: Final = (2.0, 5.0, 8.0, 12.0, 25.0)
_CLOSED: Final = int(State.CLOSED_LOOP)


@dataclass(frozen=True)
class Case:
    """A flight in which an encoder loses its zero, or its sign is wrong."""

    # `plan`: A name in `fault_sweep.PLANS`.
    # `options`: Options of the simulated board; empty without any.
    # `axis`: The axis whose count jumps; no jump if negative.
    # `jump_deg`: Change of its reading.
    # `at_s`: Simulated time of the jump.
    # `seed`: Seed of the simulation.
    # `rig`: The simulated rig; the paper's if None.

    plan: str
    options: str = ""
    axis: int = -1
    jump_deg: float = 0.0
    at_s: float = 0.0
    seed: int = 1
    rig: Rig | None = None


@dataclass(frozen=True)
class Flown:
    """Outcome and true motion of such a flight."""

    # `outcome`: As the host reported it.
    # `wrong_deg` (3,): Error of each axis' reading at the end of the closed loop: true angle less reading
    # [deg].
    # `drop_deg`: How far the arm fell after the motors had their last voltage [deg].
    # `tilt_deg`: Largest true pitch in the flight [deg].
    # `travel_deg`: Largest true travel in the flight [deg].
    # `closed_s`: From the closing of the loops until the first fault; infinite without one.
    # `most_V`: Largest sum of both voltages before the first fault.

    outcome: str
    wrong_deg: npt.NDArray[np.float64]
    drop_deg: float
    tilt_deg: float
    travel_deg: float
    closed_s: float
    most_V: float

    @property
    def completed(self) -> bool:
        return self.outcome == "completed"

    @property
    def name(self) -> str:
        """The fault's name, or the first words of another outcome."""
        words = self.outcome.removeprefix("aborted: ").removeprefix("fault ")
        return words.split(":")[0] if not self.completed else "completed"


def flown(case: Case) -> Flown:
    """Fly a case in lockstep on the native board, and compare its readings with the true angles."""
    telemetry: list[npt.NDArray[np.float64]] = []
    truth: list[list[float]] = []

    def listen(samples: Samples) -> None:
        angles = (np.degrees(getattr(samples, f"{axis}_rad")) for axis in AXES)
        volts_V = samples.front_V + samples.back_V
        telemetry.append(np.column_stack((samples.tick, samples.state, samples.fault, volts_V, *angles)))

    with tempfile.TemporaryDirectory() as folder:
        rig = "makki2024"
        if case.rig is not None:
            rig = str(Path(folder) / "rig.toml")
            write_rig(case.rig, Path(rig))
        options = filter(None, (f"rig={rig}&seed={case.seed}&board=native", case.options))
        with connect(f"sil://?speed=max&{'&'.join(options)}") as heli:
            world = world_of(heli)
            advance = world.advance
            # The arm turns in one tick while the encoder does not count, and back in the next, while it does.
            jump_ticks = [] if case.axis < 0 else [round(1e3 * case.at_s) + k for k in range(2)]

            def note() -> None:
                truth.append([world.tick, *np.degrees(world.native.state[:3]), sum(world.native.volts_V)])

            def watched(ticks: int, rx: bytes = b"", **named: Any) -> bytes:
                received = b""
                while jump_ticks and world.tick + ticks > jump_ticks[0]:
                    before = jump_ticks[0] - world.tick
                    if before > 0:
                        received += advance(before, rx)
                        ticks, rx = ticks - before, b""
                    unseen = len(jump_ticks) == 2
                    turn_deg = -case.jump_deg if unseen else case.jump_deg
                    turn_unseen(world, case.axis, turn_deg, unseen=unseen)
                    del jump_ticks[0]
                received += advance(ticks, rx, **named)
                note()
                return received

            world.advance = watched  # type: ignore[method-assign]
            heli.wait(_SETTLES_S)
            heli.on_ticks(listen)
            outcome = fly(heli, PLANS[case.plan]).outcome
            end = len(truth)
            for _ in range(round(_SWINGS_S / 0.05)):
                watched(50)
    return _judged(outcome, np.vstack(telemetry), np.array(truth), end)


def _judged(
    outcome: str, telemetry: npt.NDArray[np.float64], truth: npt.NDArray[np.float64], end: int
) -> Flown:
    """Compare the rows that `flown` records; `end` is the row of `truth` at which the flight ended."""
    tick, state, fault, volts_V, *read_deg = telemetry.T
    true_tick, true_elevation_deg, true_pitch_deg, true_travel_deg, true_volts_V = truth.T
    closed = np.flatnonzero(state == _CLOSED)
    faults = np.flatnonzero(fault != 0)
    wrong_deg = np.zeros(3)
    if len(closed):
        last = closed[-1]
        true_deg = (true_elevation_deg, true_pitch_deg, true_travel_deg)
        wrong_deg = np.array(
            [
                np.interp(tick[last], true_tick, true) - read[last]
                for true, read in zip(true_deg, read_deg, strict=True)
            ]
        )
    on = np.flatnonzero(true_volts_V > 0.0)
    drop_deg = 0.0
    if len(on):
        off = min(on[-1] + 1, len(truth) - 1)
        drop_deg = float(true_elevation_deg[off] - true_elevation_deg[off:].min())
    first_fault = faults[0] if len(faults) else len(tick)
    return Flown(
        outcome=outcome,
        wrong_deg=wrong_deg,
        drop_deg=drop_deg,
        tilt_deg=float(np.abs(true_pitch_deg[:end]).max()),
        travel_deg=float(np.abs(true_travel_deg[:end]).max()),
        closed_s=(
            1e-3 * float(tick[first_fault] - tick[closed[0]]) if len(faults) and len(closed) else np.inf
        ),
        most_V=float(volts_V[:first_fault].max(initial=0.0)),
    )


def loose(count: int, seed: int) -> Iterator[Case]:
    """Plugs that fall off for 0.1 to 5 s, and jumps, at any moment of a flight, in turn."""
    chance = np.random.default_rng((seed, 0))
    plans = [name for name in PLANS if name != "drift"]
    for number in range(count):
        axis = number // 2 % len(AXES)
        plan = plans[int(chance.integers(len(plans)))]
        at_s = round(float(chance.uniform(1.8, 35.0)), 2)
        if number % 2:
            sign = -1.0 if chance.random() < 0.5 else 1.0
            jump_deg = sign * _JUMPS_DEG[int(chance.integers(len(_JUMPS_DEG)))]
            yield Case(plan, "", axis, jump_deg, at_s, seed=number + 1)
        else:
            lasts_s = round(float(chance.uniform(0.1, 5.0)), 2)
            yield Case(plan, f"encoder_out={AXES[axis]}:{at_s}:{lasts_s}", seed=number + 1)


def random_rig(name: str, chance: np.random.Generator) -> Rig | None:
    """A rig whose numbers lie within half of their tolerances, as most do; None where there can be none."""
    rig = load_rig(name)
    fixed = ("g", "elevation_min", "elevation_max", "supply", *ENCODER_COUNTS)
    values = {
        key: number.value * (1.0 + 0.5 * number.tolerance * chance.uniform(-1.0, 1.0))
        for key, number in rig.items()
        if key not in fixed and 0.0 < number.tolerance < 1.0
    }
    try:
        return rig.replace(**values)
    except SimError:
        return None


def dead(kind: str, count: int, seed: int) -> Iterator[Case]:
    """Encoders of `kind` that die at any moment on random rigs, each rig in three flights."""
    chance = np.random.default_rng((seed, 1))
    plans = [name for name in PLANS if name != "drift"]
    rig = None
    for number in range(count):
        while rig is None or number % 3 == 0:
            rig = random_rig("makki2024", chance)
            if rig is not None:
                break
        at_s = round(float(chance.uniform(0.3, 35.0)), 2)
        yield Case(plans[number % len(plans)], f"encoder_out={kind}:{at_s}", seed=number + 1, rig=rig)


LOOSE_HEAD: Final = (
    "| what happens | flights | `completed` | error above 2 degrees in these | faults and other outcomes |"
)
DEAD_HEAD: Final = (
    "| dead encoder | flights | ended by a fault | drop, median | drop, largest | drops above 6 degrees |"
)
SIGN_HEAD: Final = (
    "| wrong sign | flights | named | within, s | largest sum of voltages | largest pitch | largest travel |"
)


def _names(flights: Sequence[Flown]) -> str:
    counts = Counter(flight.name for flight in flights if not flight.completed)
    return ", ".join(f"{count} {name}" for name, count in counts.most_common())


def loose_table(count: int, seed: int) -> list[str]:
    """Fly plugs and jumps, and return a table with a row for each axis and kind."""
    rows: dict[str, list[tuple[int, Flown]]] = {}
    for case in loose(count, seed):
        axis = case.axis if case.axis >= 0 else next(k for k, name in enumerate(AXES) if name in case.options)
        what = "jumps" if case.axis >= 0 else "plug falls off and returns"
        rows.setdefault(f"{AXES[axis]}: {what}", []).append((axis, flown(case)))
    lines = []
    for what, flights in sorted(rows.items()):
        good = [(axis, flight) for axis, flight in flights if flight.completed]
        wrong = sum(abs(flight.wrong_deg[axis]) > WRONG_DEG for axis, flight in good)
        lines.append(
            f"| {what} | {len(flights)} | {len(good)} | {wrong} | {_names([f for _, f in flights])} |"
        )
    return lines


def dead_table(count: int, seed: int) -> list[str]:
    """Fly dead encoders of elevation and pitch on random rigs, and return a table."""
    lines = []
    for kind in ("elevation", "pitch"):
        flights = [flight for case in dead(kind, count, seed) if not (flight := flown(case)).completed]
        drops_deg = np.array([flight.drop_deg for flight in flights])
        lines.append(
            f"| {kind} | {count} | {len(flights)} | {np.median(drops_deg):.1f} | {drops_deg.max():.1f} "
            f"| {(drops_deg > DROP_DEG).sum()} |"
        )
    return lines


def sign_table(count: int) -> list[str]:
    """Fly every wrong sign in two plans, and return a table."""
    lines = []
    for wiring in WIRINGS:
        cases = (Case(("step", "identify")[k % 2], wiring.options, seed=k + 1) for k in range(count))
        flights = [flown(case) for case in cases]
        name = wiring.says.removeprefix("fault ")
        lines.append(
            f"| {wiring.what} | {count} | {sum(flight.name == name for flight in flights)} `{name}` "
            f"| {max(flight.closed_s for flight in flights):.2f} "
            f"| {max(flight.most_V for flight in flights):.1f} V "
            f"| {max(flight.tilt_deg for flight in flights):.0f} degrees "
            f"| {max(flight.travel_deg for flight in flights):.0f} degrees |"
        )
    return lines


def main() -> None:
    """Fly the sweeps and print their tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", nargs="*", default=["loose", "dead", "signs"])
    parser.add_argument("--share", type=float, default=1.0, help="share of the flights to fly")
    parser.add_argument("--seed", type=int, default=48)
    given = parser.parse_args()
    if "loose" in given.what:
        print(f"{LOOSE_HEAD}\n|---|---|---|---|---|")
        print("\n".join(loose_table(round(300 * given.share), given.seed)), flush=True)
    if "dead" in given.what:
        print(f"\n{DEAD_HEAD}\n|---|---|---|---|---|---|")
        print("\n".join(dead_table(round(60 * given.share), given.seed)), flush=True)
    if "signs" in given.what:
        print(f"\n{SIGN_HEAD}\n|---|---|---|---|---|---|---|")
        print("\n".join(sign_table(round(10 * given.share))), flush=True)


if __name__ == "__main__":
    main()

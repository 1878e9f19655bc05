"""Encoders and supply that fail at any moment of any plan on several rigs, and what the arm truly did.

``python -m tests.fly.fault_sweep`` flies the sweep and prints the table of docs/validation/faults.md.
``python -m tests.fly.fault_sweep healthy`` flies rigs on which nothing fails, and prints false alarms.
"""

import argparse
import dataclasses
import itertools
import tempfile
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from heli_host.board.samples import Samples
from heli_host.declaration import AXES, Axis, Fault, State
from heli_host.fly.connection import connect
from heli_host.fly.plan import Plan, load_plan
from heli_host.fly.runner import fly
from heli_sim.rig import load_rig, write_rig

from tests.sil.harness import world_of

GAINS: Final = Path(__file__).with_name("gains")
LEFT_DEG: Final = 30.0
"""Beyond this error of true travel an unreported fault is dangerous."""
_SETTLES_S: Final = 1.5
_DOWN_MS: Final = 15_000
_CLOSED: Final = (State.CLOSED_LOOP, State.HOLD, State.LANDING)
_STOP_MARGIN_DEG: Final = 0.05
_COUNTS: Final = {"elevation": 250, "pitch": 250, "travel": 510, "supply": 60}
"""Flights of each kind of fault."""
_LATEST_S: Final = 40.0
_HEALTHY: Final = 420
_INERTIA_kg_m2: Final = 0.8195
"""Inertia of travel, J_psi of the paper: converts an acceleration into a torque."""


@dataclass(frozen=True)
class Flown:
    """A rig of the sweep."""

    # `rig`: Its name.
    # `gains`: File of `GAINS`, made by ``heli-host tune``; empty for the board's own gains.
    # `effects`: Effects of the simulation, separated by semicolons.
    # `pull_rad_s2`: Constant travel torque, as an acceleration.

    rig: str = "makki2024"
    gains: str = ""
    effects: str = ""
    pull_rad_s2: float = 0.0


RIGS: Final[Mapping[str, Flown]] = {
    "paper": Flown(),
    "identified": Flown("makki2024-identified", "makki2024-identified"),
    "course": Flown("quanser-course", "quanser-course"),
    "lag": Flown(gains="makki2024-rotor-lag", effects="rotor_lag=0.12"),
    "pull": Flown(pull_rad_s2=0.02),
}
_FRICTION: Final = "coulomb_friction.travel"
HEALTHY: Final[Mapping[str, Flown]] = {
    **RIGS,
    "strong pull": Flown(pull_rad_s2=0.14),
    "friction": Flown(effects=_FRICTION),
    "little friction": Flown(effects=f"{_FRICTION}=0.005"),
    "much friction": Flown(effects=f"{_FRICTION}=0.05"),
    "friction, course": Flown("quanser-course", "quanser-course", _FRICTION),
    "friction, identified": Flown("makki2024-identified", "makki2024-identified", _FRICTION),
    "friction and pull": Flown(effects=_FRICTION, pull_rad_s2=0.05),
    "friction everywhere": Flown(effects=f"{_FRICTION};coulomb_friction.elevation;coulomb_friction.pitch"),
    "much friction everywhere": Flown(
        effects=f"{_FRICTION};coulomb_friction.elevation=0.08;coulomb_friction.pitch=0.02"
    ),
    "cable": Flown(effects="cable_spring.travel"),
    "play": Flown(effects="backlash.travel"),
    "play and friction": Flown(effects=f"backlash.travel;{_FRICTION}"),
    "gusts": Flown(effects="random_torque.travel=0.02"),
    "gusts and friction": Flown(effects=f"random_torque.travel=0.02;{_FRICTION}"),
    "leaning axis": Flown(effects="axis_tilt"),
    "reaction torque": Flown(effects="rotor_reaction_torque"),
    "rotors": Flown(effects="thrust_asymmetry;ground_effect"),
}
PLANS: Final[Mapping[str, Plan]] = {
    **{name: load_plan(name) for name in ("hover", "sine", "step", "identify")},
    "drift": Plan.parse(
        '[[segment]]\nkind = "step"\ntravel_deg = 5\nduration_s = 12\n'
        '[[segment]]\nkind = "hold"\nduration_s = 60\n',
        "drift",
    ),
}


@dataclass(frozen=True)
class Case:
    """What fails, on which rig, in which plan, and when."""

    # `rig`, `plan`: Names in `HEALTHY` and `PLANS`.
    # `kind`: An axis whose encoder's plug falls off, ``supply``, or empty when nothing fails.
    # `at_s`: Simulated time of the fault.
    # `seed`: Seed of the simulation.

    rig: str
    plan: str
    kind: str = ""
    at_s: float = 0.0
    seed: int = 1


@dataclass(frozen=True)
class Seen:
    """Report of the board, and true position of the arm."""

    # `case`: Plan and rig of the flight.
    # `outcome`: As the host reported it.
    # `acted_s`: From the fault until the board reported one; infinite if it never did.
    # `away_deg`: Largest error of the axis between fault and report, true angle less setpoint; with elevation
    # and pitch over the whole range, as their setpoints follow the dead reading.
    # `stop`: Whether elevation, pitch or travel touched a stop of the rig before the report; the table is
    # none.

    case: Case
    outcome: str
    acted_s: float
    away_deg: float
    stop: bool

    @property
    def reported(self) -> bool:
        return bool(np.isfinite(self.acted_s))

    @property
    def tracking_fault(self) -> str:
        """Name of a fault by which the board knows that a reading or a sign is wrong; empty without."""
        names = (fault.name.lower() for fault in Fault)
        ends = ("_motionless", "_following", "_below_table", "_step", "_sign")
        return next((n for n in names if n.endswith(ends) and n in self.outcome), "")


def swept(kind: str, count: int, seed: int = 29) -> Iterator[Case]:
    """Cases of a kind of fault: every rig and plan in turn, at moments by chance."""
    chance = np.random.default_rng((seed, list(_COUNTS).index(kind)))
    pairs = itertools.cycle(itertools.product(RIGS, PLANS))
    for rig, plan in itertools.islice(pairs, count):
        yield Case(rig, plan, kind, round(float(chance.uniform(0.0, _LATEST_S)), 2))


def flown(case: Case, board: str = "native", elf: str = "") -> Seen:
    """Fly a case in lockstep, and compare what the board reported with the true state."""
    with tempfile.TemporaryDirectory() as folder:
        return _flown(case, HEALTHY[case.rig], Path(folder) / "rig.toml", board, elf)


def _address(case: Case, rig: Flown, path: Path, board: str, elf: str) -> str:
    name = rig.rig
    if rig.pull_rad_s2:
        pulled = load_rig(rig.rig).replace(torque_travel=rig.pull_rad_s2 * _INERTIA_kg_m2)
        write_rig(pulled, path)
        name = str(path)
    options = [f"speed=max&seed={case.seed}&rig={name}&board={board}"]
    options += [f"elf={elf}"] if elf else []
    options += [f"effect={rig.effects}"] if rig.effects else []
    if case.kind == "supply":
        options.append(f"supply_out={case.at_s}")
    elif case.kind:
        options.append(f"encoder_out={case.kind}:{case.at_s}")
    return f"sil://?{'&'.join(options)}"


def _flown(case: Case, rig: Flown, path: Path, board: str, elf: str) -> Seen:
    truth: list[list[float]] = []
    telemetry: list[Samples] = []
    with connect(_address(case, rig, path, board, elf)) as heli:
        world = world_of(heli)
        advance = world.advance

        def watched(*given: Any, **named: Any) -> bytes:
            received = advance(*given, **named)
            truth.append([world.tick, *world.native.state[:3]])
            return received

        world.advance = watched  # type: ignore[method-assign]
        if rig.gains:
            text = (GAINS / f"{rig.gains}.toml").read_text(encoding="utf-8")
            heli.params.restore(tomllib.loads(text)["parameters"])
        heli.wait(_SETTLES_S)
        heli.on_ticks(telemetry.append)
        summary = fly(heli, PLANS[case.plan])
        stops = [world.rig[f"{name}_max"].value for name in AXES]
    return _judged(case, summary.outcome, telemetry, np.array(truth), stops)


def _judged(
    case: Case,
    outcome: str,
    telemetry: Sequence[Samples],
    truth: npt.NDArray[np.float64],
    stops_deg: Sequence[float],
) -> Seen:
    """Compare telemetry with the truth, of which each row is a tick and its angles [rad]."""

    def reported(channel: str) -> npt.NDArray[np.float64]:
        return np.concatenate([np.asarray(getattr(samples, channel), np.float64) for samples in telemetry])

    tick, state, fault = reported("tick"), reported("state"), reported("fault")
    true_tick, true_rad = truth[:, 0], truth[:, 1:]
    closed = np.isin(state, _CLOSED)
    if not closed.any():
        return Seen(case, outcome, acted_s=np.inf, away_deg=0.0, stop=False)
    begin = max(1e3 * case.at_s, tick[closed][0])
    reports = tick[(tick >= begin) & (fault != 0)]
    acted_s = 1e-3 * float(reports[0] - begin) if len(reports) else np.inf
    end = reports[0] if len(reports) else tick[closed][-1]
    during = (true_tick >= begin) & (true_tick <= end)
    if not case.kind or not during.any():
        return Seen(case, outcome, acted_s, away_deg=0.0, stop=False)
    true_deg = np.degrees(true_rad[during])
    # Without the supply, the arm sinks: elevation shows it.
    axis = "elevation" if case.kind == "supply" else case.kind
    setpoint_deg = np.degrees(np.interp(true_tick[during], tick, reported(f"{axis}_setpoint_rad")))
    touched = np.abs(true_deg) > np.array(stops_deg) - _STOP_MARGIN_DEG
    # The lower stop of elevation is the table, which does no harm.
    touched[:, Axis.ELEVATION] = true_deg[:, Axis.ELEVATION] > stops_deg[Axis.ELEVATION] - _STOP_MARGIN_DEG
    away_deg = float(np.max(np.abs(true_deg[:, AXES.index(axis)] - setpoint_deg)))
    return Seen(case, outcome, acted_s=acted_s, away_deg=away_deg, stop=bool(touched.any()))


HEAD: Final = (
    "| fails in flight | flights | reported | longest time | largest error | flights that touched a stop "
    "| never reported, largest error |"
)


def row(kind: str, seen: Sequence[Seen]) -> str:
    """Return a row of the table, as Markdown."""
    reported = [flight for flight in seen if flight.reported]
    silent = [flight.away_deg for flight in seen if not flight.reported]
    within_s = max((flight.acted_s for flight in reported), default=0.0)
    off_deg = max((flight.away_deg for flight in reported), default=0.0)
    stops = sum(flight.stop for flight in seen)
    unknown = f"{len(silent)}, {max(silent):.0f} degrees" if silent else "0"
    name = "the motors' supply" if kind == "supply" else f"the {kind} encoder"
    return (
        f"| {name} | {len(seen)} | {len(reported)} | {within_s:.1f} s | {off_deg:.0f} degrees "
        f"| {stops} | {unknown} |"
    )


def false_alarms(count: int, seed: int = 0) -> Iterator[Seen]:
    """Fly healthy rigs, every rig and plan in turn, and yield what came of each."""
    pairs = list(itertools.product(HEALTHY, PLANS))
    for number in range(count):
        rig, plan = pairs[number % len(pairs)]
        yield flown(Case(rig, plan, seed=seed + number // len(pairs)))


def main() -> None:
    """Fly the sweep and print its table, or the false alarms of healthy rigs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", nargs="?", default="faults", choices=("faults", "healthy"))
    parser.add_argument("--share", type=float, default=1.0, help="share of the flights to fly")
    parser.add_argument("--seed", type=int, default=29)
    given = parser.parse_args()
    if given.what == "healthy":
        flights = alarms = 0
        for flight in false_alarms(round(given.share * _HEALTHY), given.seed):
            flights += 1
            if flight.tracking_fault:
                alarms += 1
                print(dataclasses.asdict(flight), flush=True)
        print(f"{flights} healthy flights, {alarms} false alarms")
        return
    print(f"{HEAD}\n|---|---|---|---|---|---|---|")
    late: list[Seen] = []
    for kind, count in _COUNTS.items():
        seen = [flown(case) for case in swept(kind, round(given.share * count), given.seed)]
        print(row(kind, seen), flush=True)
        late += [
            flight for flight in seen if flight.stop or (kind == "travel" and flight.away_deg > LEFT_DEG)
        ]
    for flight in late:
        print(dataclasses.asdict(flight))


if __name__ == "__main__":
    main()

"""A class of submissions, some of them hostile, and what `heli-host class` makes of it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from heli_host.data.log.reader import read_flight
from heli_host.declaration import PARAMS
from heli_lab.control.law_flight import trial_plan

from tests.law.hostile import PITCH_STOP_deg, STOP_deg

OUTSIDE: Final = "outside"
"""Folder next to the class; nothing in it may change."""

GOOD_LAW: Final = """\
from heli_lab.law import *

@control_law(states={{"t_s": 0.0}})
def law(now, state, parameter):
    error_rad = now.elevation_setpoint_rad - now.elevation_rad
    lift_V = 1.4 + 3.44 * now.elevation_rad + {kp} * error_rad - {kd} * now.elevation_rad_s
    pitch_rad = {kt} * (now.travel_setpoint_rad - now.travel_rad) - 1.5 * now.travel_rad_s
    tilt_V = 5.0 * (pitch_rad - now.pitch_rad) - 1.6 * now.pitch_rad_s
    front_V, back_V = motor_volts(lift_V, tilt_V)
    late = state.t_s > 3.0
    return Command({front_V}, {back_V}, {{"t_s": state.t_s + 1e-3}}{more})

LAW = law
"""


def law_text(kp: float = 16.0, kd: float = 12.0, kt: float = 1.0, **bad: str) -> str:
    """A law that follows its setpoints, or after 3 s applies other voltages."""
    words = {"front_V": "front_V", "back_V": "back_V", "more": "", **bad}
    return GOOD_LAW.format(kp=kp, kd=kd, kt=kt, **words)


def _late(volts: str) -> str:
    return f"if_else(late, {volts}, front_V)"


HOSTILE: Final[dict[str, dict[str, str]]] = {
    "endless_loop": {"law.py": "while True: pass\n"},
    "ignores_its_limit": {
        "law.py": "import signal\nsignal.signal(signal.SIGXCPU, signal.SIG_IGN)\nwhile True: pass\n"
    },
    "sleeps": {"law.py": "import time\ntime.sleep(1e6)\n"},
    "one_gigabyte": {"law.py": "data = bytearray(1 << 30)\n"},
    "writes_files": {"law.py": "open('../../outside/kept.txt', 'w').write('other')\n"},
    "changes_marks": {"law.py": "import os\nos.rename('../../outside/kept.txt', 'mine.txt')\n"},
    "opens_sockets": {"law.py": "import socket\nsocket.create_connection(('127.0.0.1', 9))\n"},
    "ends_python": {"law.py": "import os\nos._exit(0)\n"},
    "forks": {"law.py": "import os\nwhile True: os.fork()\n"},
    "kills_its_parent": {"law.py": "import os\nos.kill(os.getppid(), 9)\n"},
    "starts_processes": {"law.py": "import subprocess\nsubprocess.run(['touch', '../../outside/new.txt'])\n"},
    "forges_its_answer": {
        "law.py": 'import os\nfor pipe in range(3, 60):\n    try: os.write(pipe, b\'{"program": "[]"}\')\n'
        "    except OSError: pass\nos._exit(0)\n"
    },
    "recurses": {"law.py": "def deeper(n): return deeper(n + 1)\ndeeper(0)\n"},
    "not_a_number": {"law.py": law_text(front_V=_late("sqrt(-1.0 - state.t_s)"))},
    "full_lift": {"law.py": law_text(front_V=_late("20.0"), back_V="if_else(late, 20.0, back_V)")},
    "full_tilt": {"law.py": law_text(front_V=_late("20.0"), back_V="if_else(late, -20.0, back_V)")},
    "not_a_number_of_a_parameter": {"gains.toml": "[parameters]\nelevation_kp = nan\n"},
    "raises_a_limit": {"gains.toml": "[parameters]\nmotor_max_V = 12.0\n"},
    "plan_without_end": {
        "plan.toml": 'title = "long"\n[[segment]]\nkind = "hold"\nduration_s = 1e9\n',
    },
    "nested_plan": {"plan.toml": "a = " + "[" * 100_000 + "\n"},
}
"""Files of hostile submissions by name; each gets no points."""


def make_class(folder: Path, count: int, names: Sequence[str], duration_s: float) -> None:
    """Write a class of submissions, and the folder next to it."""
    # ``folder`` is made; of ``count`` submissions, those with ``names`` are hostile, spread over the class.
    # The others are laws, parameter files and plans in turn.
    every = count // max(len(names), 1)
    random = np.random.default_rng(1)
    for number in range(count):
        at, rest = divmod(number, every)
        if rest == 0 and at < len(names):
            name, files = names[at], HOSTILE[names[at]]
        else:
            name, files = "student", _honest(number, random, duration_s)
        place = folder / f"{number:03}_{name}"
        place.mkdir(parents=True)
        for file, text in files.items():
            (place / file).write_text(text)
    outside = folder.parent / OUTSIDE
    outside.mkdir()
    (outside / "kept.txt").write_text("kept")
    # One more way out: the folder for the answer leads elsewhere.
    first = next(path for path in sorted(folder.iterdir()) if path.name.endswith("student"))
    (first / "marked").symlink_to(outside, target_is_directory=True)


def _honest(number: int, random: np.random.Generator, duration_s: float) -> dict[str, str]:
    factor = random.uniform(0.8, 1.2, 3)
    if number % 3 == 0:
        return {"law.py": law_text(*(float(x) for x in factor * (16.0, 12.0, 1.0)))}
    if number % 3 == 1:
        return {"gains.toml": f"[parameters]\ntravel_kp = {0.5 * factor[0]:.4f}\n"}
    return {"plan.toml": trial_plan(duration_s + 0.1 * (number % 5)).text}


def unsafe_ticks(log: Path) -> int:
    """Ticks of a log in which a motor is outside its limits, runs while off, or the arm is at a stop."""
    flight = read_flight(log, allow_gaps=True)
    limits = {spec.name: spec.default for spec in PARAMS}
    assert flight.state is not None
    off = np.isin(flight.state, [n for n, name in flight.state_names.items() if name in ("idle", "fault")])
    volts = flight.voltages_V
    bad = ~np.isfinite(volts).all(axis=1)
    bad |= (volts > limits["motor_max_V"] + 0.01).any(axis=1)
    bad |= (volts < limits["motor_min_V"] - 0.01).any(axis=1)
    bad |= off & (volts != 0.0).any(axis=1)
    bad |= np.rad2deg(flight.elevation_rad) > STOP_deg
    bad |= np.abs(np.rad2deg(flight.pitch_rad)) > PITCH_STOP_deg
    return int(bad.sum())


@dataclass(frozen=True)
class Marked:
    """Result of a run of `heli-host class` left."""

    # ``exit_code`` and ``text`` of the command, its ``marks`` by name, ``ticks`` and ``unsafe`` ticks in all
    # logs, ``digest`` of all files that it should not change.

    exit_code: int
    text: str
    marks: dict[str, dict[str, Any]]
    ticks: int
    unsafe: int
    digest: str


Run = Callable[[Sequence[str]], tuple[int, str]]
"""Runs a command line; its exit code and what it printed."""


def mark_class(folder: Path, *options: str, run: Run) -> Marked:
    """Run `heli-host class` over a folder, and look at what it left."""
    result = folder.parent / "class.json"
    code, text = run(["class", str(folder), "--json", str(result), *options])
    marks = json.loads(result.read_text())["marks"] if code == 0 else []
    logs = sorted(folder.glob("*/marked/*.mcap"))
    return Marked(
        code,
        text,
        {mark["submission"]: mark for mark in marks},
        sum(len(read_flight(log, allow_gaps=True)) for log in logs),
        sum(unsafe_ticks(log) for log in logs),
        digest(folder),
    )


def digest(folder: Path) -> str:
    """Digest of the folder outside, and of every file of the submissions that is not an answer to them."""
    summed = hashlib.sha256()
    for path in sorted(_kept_files(folder)):
        summed.update(f"{path}\n".encode() + path.read_bytes())
    return summed.hexdigest()


def _kept_files(folder: Path) -> Iterator[Path]:
    yield from (path for path in (folder.parent / OUTSIDE).rglob("*") if path.is_file())
    for path in folder.rglob("*"):
        if path.is_file() and "marked" not in path.parts and path.name != "marks.csv":
            yield path


def problems(folder: Path, first: Marked, second: Marked, before: str) -> list[str]:
    """What is wrong with two runs over a class; empty if nothing is."""
    names = {path.name for path in folder.iterdir() if path.is_dir()}
    hostile = {name for name in names if not name.endswith("student")}
    checks: dict[str, Any] = {}
    for run in (first, second):
        checks |= {
            f"exit code {run.exit_code}: {run.text[-500:]}": run.exit_code == 0,
            "a traceback": "Traceback" not in run.text,
            f"no answer: {sorted(names - run.marks.keys())}": names == run.marks.keys(),
            f"{run.unsafe} unsafe ticks": run.unsafe == 0,
            "a file of a submission or outside has changed": run.digest == before,
        }
    for name, mark in sorted(first.marks.items()):
        checks[f"{name}: {mark['points']} points; {mark['reason']}"] = (
            mark["points"] == 0.0 and mark["reason"]
            if name in hostile
            else mark["points"] > 0.0 and not mark["reason"]
        )
        checks[f"{name}: no mark.json"] = (folder / name / "marked" / "mark.json").is_file()
        again = {**second.marks.get(name, {}), "rig": mark["rig"]}
        checks[f"{name}: the second mark is another"] = mark == again
    return [text for text, good in checks.items() if not good]

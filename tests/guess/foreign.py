"""Raw files as the repositories of other courses hold them, drawn from a seed, with their true profiles."""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.data.tables import Angle, Profile, Voltage
from heli_sim.rig import Rig, load_rig

from tests.guess.flights import PILOTS, PilotFlight, piloted

AXES: Final = ("elevation", "pitch", "travel")
FORMS: Final = (
    *("matrix.mat", "structure.mat", "variables.mat", "timeseries.mat", "vectors.mat"),
    *("two.mat", "two_without_time.mat", "header.csv", "plain.csv", "plain.txt"),
    *("plain.xlsx", "titled.xlsx", "second.xlsx"),
)
_NAMES: Final = {
    "words": (
        *("time", "elevation", "pitch", "travel", "elevation_rate", "pitch_rate", "travel_rate"),
        *("front_motor", "back_motor", "V_sum", "V_diff", "elevation_ref"),
    ),
    "course": ("t", "e", "p", "lambda", "e_dot", "p_dot", "lambda_dot", "V_f", "V_b", "V_s", "V_d", "e_c"),
    "states": ("t", "x1", "x2", "x3", "x4", "x5", "x6", "u1", "u2", "u1", "u2", "r1"),
    "indexed": (
        *("time", "y[1]", "y[2]", "y[3]", "y[4]", "y[5]", "y[6]"),
        *("u[1]", "u[2]", "u[1]", "u[2]", "r[1]"),
    ),
}
"""Time, three angles, three rates, front, back, sum, difference, setpoint of elevation."""
_DELAYED: Final = ("travel", "elevation", "voltages")


@dataclass(frozen=True)
class ForeignFile:
    """One flight as another program writes it, and the right answer."""

    # `paths`: One file, or two that hold one flight.
    # `profile`: A profile without wrong entries.
    # `truth`: What `profile` makes of the file, without jumps and delays.
    # `rig`: Rig file that the user gives; None if the user gives none.
    # `about`: The draw in one line.

    paths: tuple[Path, ...]
    profile: Profile
    truth: Flight
    rig: Rig | None
    about: str


@dataclass(frozen=True)
class _Signal:
    name: str
    unit: str
    values: Floats


def write(seed: int, folder: Path) -> ForeignFile:
    """Write the file of a `seed` into a `folder`."""
    random = np.random.default_rng([seed, 33])
    form = FORMS[seed % len(FORMS)]

    def draw(*choices: Any, p: tuple[float, ...] | None = None) -> Any:
        return choices[int(random.choice(len(choices), p=p))]

    rig_name = draw("quanser-course", "makki2024", p=(0.7, 0.3))
    pilot = draw(*PILOTS)
    source = piloted(rig_name, pilot, seed)
    rig = load_rig(rig_name)
    every = draw(1, 1, 5, 10)
    kind = draw("pair", "sum", "sum without bias", "halves", p=(0.45, 0.2, 0.2, 0.15))
    volt_unit = draw("V", "percent", "duty", "pwm", p=(0.6, 0.16, 0.12, 0.12))
    if kind != "pair":
        volt_unit = "V" if volt_unit == "pwm" else volt_unit
    commanded = bool(random.random() < 0.5)
    angle_unit = draw("rad", "deg", "count", p=(0.45, 0.4, 0.15))
    signs = [float(draw(1.0, -1.0, p=(0.75, 0.25))) for _ in AXES]
    swapped = bool(random.random() < 0.2)
    at_rest = bool(random.random() < 0.5)
    style = draw(*_NAMES)
    stated = style == "words" and bool(random.random() < 0.5)
    extras = draw("none", "rates", "rates and setpoint")
    late = (draw(*_DELAYED), float(random.uniform(0.12, 0.25))) if random.random() < 0.2 else ("", 0.0)
    event = draw("", "jump", "gap", p=(0.7, 0.15, 0.15))
    given = bool(random.random() < 0.5)
    flight, commands_V, rates, setpoints = _thinned(source, every)
    step_s = flight.step_s
    truth_profile, signals, setpoint = _signals(
        flight, commands_V if commanded else flight.voltages_V, rates, setpoints, source.bias_V, rig,
        kind, volt_unit, angle_unit, signs, swapped, at_rest, style, stated,
    )  # fmt: skip
    if late[0]:
        truth_profile, signals = _delayed(truth_profile, signals, late, step_s)
    if event == "jump":
        signals = _jumped(signals, truth_profile, draw(*AXES), len(flight) * 2 // 3, rig)
    if extras != "none":
        signals["rates"] = _rate_signals(rates, truth_profile, rig, style)
        if extras != "rates":
            signals["setpoint"] = [setpoint]
    order = [int(place) for place in random.permutation(3)]
    signals |= {k: [signals[k][place] for place in order] for k in ("angles", "rates") if k in signals}
    groups = [signals["angles"], signals.get("rates", []), signals.get("setpoint", []), signals["voltages"]]
    if random.random() < 0.4:
        groups = groups[::-1]
    if extras != "none" and style in ("states", "course") and random.random() < 0.5:
        # Simulink's state vectors alternate: an angle, then its rate.
        pairs = [s for pair in zip(signals["angles"], signals["rates"], strict=True) for s in pair]
        groups = [pairs, signals.get("setpoint", []), signals["voltages"]]
    t_s = flight.t_s - flight.t_s[0]
    rows = np.ones(t_s.size, bool)
    if event == "gap":
        start = int(random.integers(t_s.size // 3, t_s.size * 2 // 3))
        rows[start : start + 3] = False
        rows[start + 60 : start + 60 + int(0.4 / step_s)] = False
    ordered = [replace(s, values=s.values[rows]) for group in groups for s in group]
    time_name = f"{_NAMES[style][0]} [s]" if stated else _NAMES[style][0]
    paths, time_column, columns = _FORMATS[form](folder, form, time_name, t_s[rows], ordered, truth_profile)
    profile = _renamed(truth_profile, time_column, columns)
    about = (
        f"{form} {rig_name}{'' if given else ' not given'} {pilot} {1.0 / step_s:.0f} Hz, {style}"
        f"{' stated' if stated else ''}, {angle_unit}, {kind} in {volt_unit}"
        f"{' commands' if commanded else ''}, signs {[int(s) for s in signs]}"
        f"{' swapped' if swapped else ''}{' rest 0' if at_rest else ''}, {extras}"
        f"{f', {late[0]} {late[1]:.2f} s late' if late[0] else ''} {event}"
    )
    return ForeignFile(paths, profile, flight, rig if given else None, about)


def _thinned(source: PilotFlight, every: int) -> tuple[Flight, Floats, Floats, Floats]:
    flight, keep = source.flight, slice(None, None, every)
    thin = Flight(flight.t_s[keep], *flight.voltages_V[keep].T, *flight.angles_rad[keep].T)
    return thin, source.commands_V[keep], source.rates_rad_s[keep], source.setpoints_rad[keep]


def _signals(
    flight: Flight, volts: Floats, rates: Floats, setpoints: Floats, bias_V: float, rig: Rig,
    kind: str, volt_unit: str, angle_unit: str, signs: list[float], swapped: bool, at_rest: bool,
    style: str, stated: bool,
) -> tuple[Profile, dict[str, list[_Signal]], _Signal]:  # fmt: skip
    """Scale angles and voltages, and state how to read them."""
    names = _NAMES[style]
    angles: dict[str, Angle] = {}
    written: list[_Signal] = []
    for place, (axis, sign) in enumerate(zip(AXES, signs, strict=True)):
        counts = rig[f"encoder_counts_{axis}"].value
        rest_rad = flight.elevation_rad[0] if at_rest and axis == "elevation" else 0.0
        angle = Angle(names[1 + place], angle_unit, counts, sign, float(np.degrees(rest_rad)))
        values = sign * (flight.angles_rad[:, place] - rest_rad) / angle.rad
        angles[axis] = angle
        written.append(
            _Signal(angle.column, angle_unit, np.round(values) if angle_unit == "count" else values)
        )
    first, second = volts[:, 0], volts[:, 1]
    supply_V = rig["supply"].value
    share = Voltage("", volt_unit, supply_V=supply_V)
    if kind == "pair":
        labels = (names[7], names[8])
        pair = dict(zip(("back", "front") if swapped else ("front", "back"), labels, strict=True))
        voltages = {role: replace(share, column=pair[role]) for role in ("front", "back")}
        logged = [second, first] if swapped else [first, second]
    else:
        labels = (names[9], names[10])
        factor = 2.0 if kind == "halves" else 1.0
        offset = bias_V if kind == "sum without bias" else 0.0
        voltages = {
            "sum": replace(share, column=labels[0], offset_V=offset, factor=factor),
            "difference": replace(share, column=labels[1], sign=-1.0 if swapped else 1.0, factor=factor),
        }
        logged = [first + second - offset, (second - first) if swapped else (first - second)]
    scaled = []
    for label, values in zip(labels, logged, strict=True):
        voltage = next(v for v in voltages.values() if v.column == label)
        cells = values / voltage.volts
        scaled.append(_Signal(label, volt_unit, np.round(cells) if volt_unit == "pwm" else cells))
    elevation = angles["elevation"]
    reference = elevation.sign * (setpoints[:, 0] - math.radians(elevation.offset_deg)) / elevation.rad
    profile = Profile(angles, voltages, names[0], "s")
    if not stated:
        written, scaled = ([replace(s, unit="") for s in group] for group in (written, scaled))
    return profile, {"angles": written, "voltages": scaled}, _Signal(names[11], "", reference)


def _rate_signals(rates: Floats, profile: Profile, rig: Rig, style: str) -> list[_Signal]:
    signals = []
    for place, axis in enumerate(AXES):
        angle = profile.angles[axis]
        signals.append(_Signal(_NAMES[style][4 + place], "", angle.sign * rates[:, place] / angle.rad))
    return signals


def _delayed(
    profile: Profile, signals: dict[str, list[_Signal]], late: tuple[str, float], step_s: float
) -> tuple[Profile, dict[str, list[_Signal]]]:
    """Delay a column, and state the delay in the profile."""
    which, rows = late[0], round(late[1] / step_s)

    def shift(signal: _Signal) -> _Signal:
        moved = np.concatenate((np.full(rows, signal.values[0]), signal.values[:-rows]))
        return replace(signal, values=moved)

    if which == "voltages":
        voltages = {name: replace(v, delay_s=rows * step_s) for name, v in profile.voltages.items()}
        moved = {**signals, "voltages": [shift(s) for s in signals["voltages"]]}
        return replace(profile, voltages=voltages), moved
    place = AXES.index(which)
    angles = dict(profile.angles) | {which: replace(profile.angles[which], delay_s=rows * step_s)}
    shifted = [shift(s) if i == place else s for i, s in enumerate(signals["angles"])]
    return replace(profile, angles=angles), {**signals, "angles": shifted}


def _jumped(
    signals: dict[str, list[_Signal]], profile: Profile, axis: str, row: int, rig: Rig
) -> dict[str, list[_Signal]]:
    """Let an angle jump by 21 degrees from `row` on, as where an encoder is set to zero again."""
    place = AXES.index(axis)
    jump = math.radians(21.0) / profile.angles[axis].rad
    jump = round(jump) if profile.angles[axis].unit == "count" else jump
    angles = list(signals["angles"])
    values = angles[place].values.copy()
    values[row:] += jump
    angles[place] = replace(angles[place], values=values)
    return {**signals, "angles": angles}


def _renamed(profile: Profile, time: str, columns: dict[str, str]) -> Profile:
    angles = {axis: replace(a, column=columns[a.column]) for axis, a in profile.angles.items()}
    voltages = {role: replace(v, column=columns[v.column]) for role, v in profile.voltages.items()}
    return replace(profile, angles=angles, voltages=voltages, time=time)


_Written = tuple[tuple[Path, ...], str, dict[str, str]]


def _label(signal: _Signal) -> str:
    return f"{signal.name} [{signal.unit}]" if signal.unit else signal.name


def _matrix(
    folder: Path, form: str, time: str, t_s: Floats, signals: list[_Signal], profile: Profile
) -> _Written:
    """One matrix of a To File block, a row per signal, the time first; or two such files."""
    from scipy.io import savemat

    if form == "matrix.mat":
        path = folder / "heli.mat"
        savemat(path, {"data": np.array([t_s, *(s.values for s in signals)])})
        return (path,), "data[1]", {s.name: f"data[{i}]" for i, s in enumerate(signals, 2)}
    volts = {v.column for v in profile.voltages.values()}
    halves = [[s for s in signals if s.name not in volts], [s for s in signals if s.name in volts]]
    paths: list[Path] = []
    columns: dict[str, str] = {}
    for number, (name, part) in enumerate(zip(("x", "u"), halves, strict=True), 1):
        timed = number == 1 or form == "two.mat"
        rows = [*([t_s] if timed else []), *(s.values for s in part)]
        savemat(folder / f"{name}.mat", {name: np.array(rows)})
        paths.append(folder / f"{name}.mat")
        columns |= {s.name: f"{number}: {name}[{i}]" for i, s in enumerate(part, 2 if timed else 1)}
    return tuple(paths), "time [s]", columns


def _structures(
    folder: Path, form: str, time: str, t_s: Floats, signals: list[_Signal], profile: Profile
) -> _Written:
    """MATLAB files with names: a structure with time, vectors of a workspace, and time series of 7.3."""
    from scipy.io import savemat

    path = folder / form
    words = {s.name: s.name.replace("[", "").replace("]", "") for s in signals}
    if form == "structure.mat":
        parts = [{"values": s.values[:, None], "dimensions": 1.0, "label": _label(s)} for s in signals]
        savemat(path, {"ScopeData": {"time": t_s[:, None], "signals": parts, "blockName": "heli/Scope"}})
        return (path,), "time [s]", {s.name: _label(s) for s in signals}
    if form == "variables.mat":
        gains = {"K": np.eye(2, 6), "m_p": 0.72}
        savemat(
            path,
            {
                time.split(" ", maxsplit=1)[0]: t_s[:, None],
                **gains,
                **{words[s.name]: s.values for s in signals},
            },
        )
        return (path,), time.split(" ", maxsplit=1)[0], words
    from matio import save_to_mat

    if form == "timeseries.mat":
        save_to_mat(str(path), {words[s.name]: _series(words[s.name], t_s, s.values) for s in signals})
        return (path,), "time [s]", words
    # Two time series of vectors, as To Workspace writes buses: states and inputs.
    volts = {v.column for v in profile.voltages.values()}
    groups = {"x": [s for s in signals if s.name not in volts], "u": [s for s in signals if s.name in volts]}
    save_to_mat(
        str(path),
        {
            name: _series(name, t_s, np.column_stack([s.values for s in part]))
            for name, part in groups.items()
        },
    )
    return (
        (path,),
        "time [s]",
        {s.name: f"{name}[{i}]" for name, part in groups.items() for i, s in enumerate(part, 1)},
    )


def _series(name: str, t_s: Floats, values: Floats) -> Any:
    """A time series as MATLAB stores it: the times within TimeInfo, the data within Storage_."""
    from matio.utils.matclass import MatlabOpaque

    rows = values if values.ndim == 2 else values[:, None]
    nothing = np.zeros((0, 0))
    times = {
        "Units": "seconds",
        "Start": np.array([[t_s[0]]]),
        "End": np.array([[t_s[-1]]]),
        "Increment": nothing,
        "Length": np.array([[float(t_s.size)]]),
        "Time_": t_s[:, None],
    }
    properties = {
        "Events": nothing,
        "Name": name,
        "Data_": nothing,
        "Time_": nothing,
        "TimeInfo": MatlabOpaque(times, "tsdata.timemetadata"),
        "Storage_": MatlabOpaque({"Data": rows}, "matlab.internal.timeseries.storage"),
    }
    return MatlabOpaque(properties, "timeseries")


def _text(
    folder: Path, form: str, time: str, t_s: Floats, signals: list[_Signal], profile: Profile
) -> _Written:
    """Text with a header or without one."""
    path = folder / form
    separator = " " if form.endswith("txt") else ","
    table = np.column_stack([t_s, *(s.values for s in signals)])
    lines = [separator.join(f"{value:.8g}" for value in row) for row in table]
    if form == "header.csv":
        labels = [time, *(_label(s) for s in signals)]
        path.write_text("\n".join([",".join(labels), *lines]) + "\n", encoding="utf-8")
        return (path,), time, {s.name: _label(s) for s in signals}
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return (path,), "column 1", {s.name: f"column {i}" for i, s in enumerate(signals, 2)}


def _sheet(
    folder: Path, form: str, time: str, t_s: Floats, signals: list[_Signal], profile: Profile
) -> _Written:
    """A spreadsheet: plain, below title lines, or on the second sheet."""
    import openpyxl

    path = folder / form
    book = openpyxl.Workbook(write_only=True)
    if form == "second.xlsx":
        notes = book.create_sheet("Info")
        notes.append(["Helicopter lab, group 8"])
        notes.append(["Rig", 3, "Date", "2024-03-01"])
    sheet = book.create_sheet("Data")
    if form == "titled.xlsx":
        sheet.append(["Measurement 3, flown by group 8"])
        sheet.append(["Date", "2024-03-01"])
        sheet.append([])
    sheet.append([time, *(_label(s) for s in signals)])
    for row in np.column_stack([t_s, *(s.values for s in signals)]).tolist():
        sheet.append(row)
    book.save(path)
    return (path,), time, {s.name: _label(s) for s in signals}


_FORMATS: Final = {
    form: (
        _matrix
        if form in ("matrix.mat", "two.mat", "two_without_time.mat")
        else {"mat": _structures, "csv": _text, "txt": _text, "xlsx": _sheet}[form.rpartition(".")[2]]
    )
    for form in FORMS
}

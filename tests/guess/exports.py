"""Forms in which courses and programs write such flights, and the entries that a guess of them has wrong."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from heli_host.data.arrays import Floats
from heli_host.data.flight import Flight
from heli_host.data.tables import Profile, Table, flights_of
from heli_host.data.tables.convert import times_of
from heli_lab.setup.guess import Guess

BIAS_V = 7.3
DEG = 180.0 / math.pi


def state_rows(flight: Flight, per_rad: float = 1.0) -> list[Floats]:
    """Travel, pitch and elevation, each with its rate behind it, as a `To File` block has them."""
    rows = []
    for axis in ("travel", "pitch", "elevation"):
        angle = getattr(flight, f"{axis}_rad") * per_rad
        rows += [angle, _rate(angle, flight.step_s)]
    return rows


def setpoint_rows(flight: Flight, per_rad: float = 1.0) -> list[Floats]:
    """Steps of pitch about where it will be, and of elevation."""
    rows = round(1.5 / flight.step_s)
    held = np.minimum(np.arange(len(flight)) // rows * rows + rows // 2, len(flight) - 1)
    steps = np.where(np.arange(len(flight)) > len(flight) // 3, 5.0 / DEG, 0.0)
    return [flight.pitch_rad[held] * per_rad, steps * per_rad]


def voltage_rows(flight: Flight, bias_V: float = 0.0) -> list[Floats]:
    """Difference and sum, the sum less its bias."""
    return [flight.front_V - flight.back_V, flight.front_V + flight.back_V - bias_V]


def write_mat(path: Path, t_s: Floats, rows: list[Floats]) -> Path:
    """One matrix `ans`, a row a signal, the times first."""
    from scipy.io import savemat

    savemat(path, {"ans": np.array([t_s, *rows])})
    return path


def _rate(angle: Floats, step_s: float) -> Floats:
    weights = np.exp(-np.arange(0.0, 0.1, step_s) / 0.02)
    raw: Floats = np.convolve(np.gradient(angle, step_s), weights / weights.sum())
    return raw[: angle.size]


Form = Callable[[Flight, Path], Path]

_COUNTS: Final = 4096.0
_AXES: Final = ("elevation", "pitch", "travel")


def _table(
    path: Path,
    header: Sequence[str],
    columns: Sequence[Floats | Sequence[str]],
    separator: str = ",",
    comma: bool = False,
    encoding: str = "utf-8",
) -> Path:
    lines = [separator.join(header)] if header else []
    cells = [[item if isinstance(item, str) else f"{item:.9g}" for item in column] for column in columns]
    for row in zip(*cells, strict=True):
        text = separator.join(row)
        lines.append(text.replace(".", ",") if comma else text)
    path.write_text("\n".join(lines) + "\n", encoding=encoding)
    return path


def _slow(flight: Flight, every: int = 5) -> dict[str, Floats]:
    names = ("t_s", "front_V", "back_V", "elevation_rad", "pitch_rad", "travel_rad")
    return {name: getattr(flight, name)[::every] for name in names}


def _degrees(flight: Flight) -> list[Floats]:
    some = _slow(flight)
    return [some[f"{axis}_rad"] * DEG for axis in _AXES]


def _in_radians(flight: Flight, path: Path, header: list[str]) -> Path:
    """Times, elevation, pitch, travel, front and back under these names."""
    some = _slow(flight)
    angles = [some[f"{axis}_rad"] for axis in _AXES]
    return _table(path, header, [some["t_s"], *angles, some["front_V"], some["back_V"]])


def norwegian(flight: Flight, folder: Path) -> Path:
    some = _slow(flight)
    header = ["Tid (s)", "Høyde (grader)", "Helling (grader)", "Vandring (grader)", "Foran (V)", "Bak (V)"]
    columns = [some["t_s"], *_degrees(flight), some["front_V"], some["back_V"]]
    return _table(folder / "norsk.csv", header, columns, ";", comma=True)


def german(flight: Flight, folder: Path) -> Path:
    some = _slow(flight)
    header = ["Zeit_ms", "U_vorne", "U_hinten", "Höhenwinkel", "Nickwinkel", "Drehwinkel"]
    columns = [some["t_s"] * 1e3, some["front_V"], some["back_V"], *_degrees(flight)]
    return _table(folder / "deutsch.csv", header, columns, ";", comma=True, encoding="latin-1")


def french(flight: Flight, folder: Path) -> Path:
    some = _slow(flight)
    header = [
        "Temps [s]",
        "Élévation [°]",
        "Tangage [°]",
        "Rotation [°]",
        "Moteur avant [V]",
        "Moteur arrière [V]",
    ]
    columns = [some["t_s"], *_degrees(flight), some["front_V"], some["back_V"]]
    return _table(folder / "francais.csv", header, columns, "\t", comma=True)


def spanish(flight: Flight, folder: Path) -> Path:
    header = ["tiempo", "elevacion", "cabeceo", "giro", "v_delantero", "v_trasero"]
    return _in_radians(flight, folder / "es.csv", header)


def chinese(flight: Flight, folder: Path) -> Path:
    some = _slow(flight)
    header = ["时间(s)", "高度角(°)", "俯仰角(°)", "旋转角(°)", "前电机(V)", "后电机(V)"]
    columns = [some["t_s"], *_degrees(flight), some["front_V"], some["back_V"]]
    return _table(folder / "gbk.csv", header, columns, encoding="gb18030")


def epsilon_theta(flight: Flight, folder: Path) -> Path:
    """Greek letters of books in which theta is the pitch."""
    return _in_radians(flight, folder / "eps.csv", ["t", "epsilon", "theta", "psi", "U1", "U2"])


def phi_theta(flight: Flight, folder: Path) -> Path:
    """Names of an aeroplane's angles in another order: phi is the elevation, theta the pitch."""
    return _in_radians(flight, folder / "phi.csv", ["t", "phi", "theta", "psi", "Vf", "Vb"])


def state_space(flight: Flight, folder: Path) -> Path:
    states = state_rows(flight)
    columns = [flight.t_s, *states, flight.front_V, flight.back_V]
    return _table(
        folder / "x.csv", ["t", *(f"x{i}" for i in range(1, 7)), "u1", "u2"], [c[::5] for c in columns]
    )


def to_workspace(flight: Flight, folder: Path) -> Path:
    """A structure with time of one To Workspace block whose values are a matrix, a row a signal."""
    from scipy.io import savemat

    rows = np.array([*state_rows(flight), *voltage_rows(flight)])
    signals = {"values": rows, "dimensions": 8.0, "label": "", "blockName": "heli/To Workspace"}
    path = folder / "simout.mat"
    savemat(path, {"simout": {"time": flight.t_s[:, None], "signals": signals, "blockName": "heli"}})
    return path


def scope_with_labels(flight: Flight, folder: Path) -> Path:
    from scipy.io import savemat

    named = {
        "Elevation [deg]": (flight.elevation_rad - flight.elevation_rad[0]) * DEG,
        "Pitch [deg]": flight.pitch_rad * DEG,
        "Travel [deg]": flight.travel_rad * DEG,
        "Vf": flight.front_V,
        "Vb": flight.back_V,
    }
    signals = [
        {"values": values[:, None], "dimensions": 1.0, "label": label} for label, values in named.items()
    ]
    path = folder / "ScopeData.mat"
    savemat(path, {"ScopeData": {"time": flight.t_s[:, None], "signals": signals}})
    return path


def workspace_variables(flight: Flight, folder: Path) -> Path:
    """`save` of a workspace: vectors, constants, gains, and a time vector."""
    from scipy.io import savemat

    path = folder / "workspace.mat"
    savemat(
        path,
        {
            "t": flight.t_s,
            "elev": flight.elevation_rad,
            "p": flight.pitch_rad,
            "lambda": flight.travel_rad,
            "V_d": flight.front_V - flight.back_V,
            "V_s": flight.front_V + flight.back_V,
            "K": np.eye(2, 6),
            "m_p": 0.72,
            "A": np.zeros((6, 6)),
        },
    )
    return path


def series(flight: Flight, folder: Path) -> Path:
    """A log of time series, each with its own times, voltages at a tenth of the rate."""
    from scipy.io import savemat

    def item(values: Floats, every: int = 1) -> dict[str, Floats]:
        return {"Time": flight.t_s[::every, None], "Data": values[::every].reshape(1, 1, -1)}

    path = folder / "logsout.mat"
    logged = {f"{axis}_meas": item(getattr(flight, f"{axis}_rad")) for axis in _AXES}
    logged |= {"u_front": item(flight.front_V), "u_back": item(flight.back_V)}
    savemat(path, {"logsout": logged})
    return path


def serial_monitor(flight: Flight, folder: Path) -> Path:
    """An Arduino's lines: milliseconds since it started, counts, PWM; no header."""
    some = _slow(flight)
    counts = [
        np.round(some[f"{axis}_rad"] * _COUNTS * turns / (2.0 * math.pi))
        for axis, turns in zip(_AXES, (1, 1, 2), strict=True)
    ]
    pwm = [np.round(some[f"{motor}_V"] / 10.0 * 255.0) for motor in ("front", "back")]
    return _table(folder / "putty.log.txt", [], [12345.0 + np.round(some["t_s"] * 1e3), *counts, *pwm])


def wrapped_counts(flight: Flight, folder: Path) -> Path:
    """Counts of 16 bits without a sign."""
    some = _slow(flight)
    counts = [
        np.mod(np.round(some[f"{axis}_rad"] * _COUNTS * turns / (2.0 * math.pi)), 65536.0)
        for axis, turns in zip(_AXES, (1, 1, 2), strict=True)
    ]
    header = ["time_ms", "enc_elev", "enc_pitch", "enc_travel", "Vf", "Vb"]
    return _table(folder / "enc.csv", header, [some["t_s"] * 1e3, *counts, some["front_V"], some["back_V"]])


def half_sums(flight: Flight, folder: Path) -> Path:
    some = _slow(flight)
    total, difference = some["front_V"] + some["back_V"], some["front_V"] - some["back_V"]
    header = ["t", "travel", "pitch", "elevation", "u_coll", "u_diff"]
    angles = [some[f"{axis}_rad"] for axis in reversed(_AXES)]
    return _table(folder / "half.csv", header, [some["t_s"], *angles, 0.5 * total, 0.5 * difference])


def half_sums_unnamed(flight: Flight, folder: Path) -> Path:
    rows = [*state_rows(flight), *(0.5 * item for item in voltage_rows(flight))]
    return write_mat(folder / "half.mat", flight.t_s, rows)


def crowded(flight: Flight, folder: Path) -> Path:
    """Angles, rates, optimal states, estimates, a constant, noise: 20 rows without a name."""
    random = np.random.default_rng(3)
    states = state_rows(flight)
    optimal = []
    for item in states[::2]:
        smooth = np.convolve(item, np.ones(400) / 400.0, mode="same")
        optimal += [smooth, np.gradient(smooth, flight.step_s)]
    inertial = [item + random.normal(0.0, 0.02, item.size) for item in states[2::2]]
    rows = [
        *optimal,
        *setpoint_rows(flight),
        *states,
        *inertial,
        np.full(len(flight), 3.0),
        *voltage_rows(flight),
    ]
    return write_mat(folder / "day4.mat", flight.t_s, rows)


def before_and_after_calibration(flight: Flight, folder: Path) -> Path:
    some = _slow(flight)
    raw = [
        np.round((some[f"{axis}_rad"] - some[f"{axis}_rad"][0]) * _COUNTS * turns / (2.0 * math.pi))
        for axis, turns in zip(_AXES, (1, 1, 2), strict=True)
    ]
    header = [
        "time",
        "elev_raw",
        "pitch_raw",
        "travel_raw",
        "elev_deg",
        "pitch_deg",
        "travel_deg",
        "Vf",
        "Vb",
    ]
    columns = [some["t_s"], *raw, *_degrees(flight), some["front_V"], some["back_V"]]
    return _table(folder / "cal.csv", header, columns)


def clock_strings(flight: Flight, folder: Path) -> Path:
    some = _slow(flight)
    at = [f"13:{int(t + 2840) // 60:02d}:{(t + 2840) % 60:06.3f}" for t in some["t_s"]]
    header = ["Time", "Elevation", "Pitch", "Travel", "Front", "Back"]
    return _table(folder / "clock.csv", header, [at, *_degrees(flight), some["front_V"], some["back_V"]])


def dates(flight: Flight, folder: Path) -> Path:
    some = _slow(flight)
    start = np.datetime64("2024-01-04T12:58:31.250", "us")
    at = [str(start + np.timedelta64(round(t * 1e6), "us")).replace("T", " ") for t in some["t_s"]]
    header = ["timestamp", "elevation", "pitch", "travel", "front", "back"]
    return _table(folder / "dates.csv", header, [at, *_degrees(flight), some["front_V"], some["back_V"]])


def since_1970(flight: Flight, folder: Path) -> Path:
    some = _slow(flight)
    at = [f"{1704373111.25 + t:.6f}" for t in some["t_s"]]
    header = ["stamp", "state", "elevation", "pitch", "travel", "cmd_front", "cmd_back"]
    state = ["FLY"] * len(at)
    return _table(folder / "ros.csv", header, [at, state, *_degrees(flight), some["front_V"], some["back_V"]])


def trailing_zeros(flight: Flight, folder: Path) -> Path:
    """A buffer that was made too long: zeros behind the flight, times too."""
    rows = [*state_rows(flight), *voltage_rows(flight)]
    spare: Floats = np.zeros(len(flight) // 5)
    return write_mat(
        folder / "buffer.mat",
        np.concatenate((flight.t_s, spare)),
        [np.concatenate((item, spare)) for item in rows],
    )


def logged_on(flight: Flight, folder: Path) -> Path:
    """The log goes on after the stop: voltages are zero, the arm lies on its table."""
    spare = 10 * 500
    t_s = np.arange(len(flight) + spare, dtype=np.float64) * flight.step_s
    rest = [flight.travel_rad[-1] * DEG, 0.0, flight.elevation_rad[0] * DEG]
    angles = [flight.travel_rad * DEG, flight.pitch_rad * DEG, flight.elevation_rad * DEG]
    rows = [np.concatenate((item, np.full(spare, end))) for item, end in zip(angles, rest, strict=True)]
    rows += [np.concatenate((item, np.zeros(spare))) for item in (flight.front_V, flight.back_V)]
    return write_mat(folder / "on.mat", t_s, rows)


def times_begin_again(flight: Flight, folder: Path) -> Path:
    """Two runs in one file: the time begins at 0 again."""
    some = _slow(flight)
    half = 2 * len(some["t_s"]) // 3
    t_s = np.concatenate((some["t_s"][:half], some["t_s"][half:] - some["t_s"][half]))
    header = ["t", "elevation_deg", "pitch_deg", "travel_deg", "front_V", "back_V"]
    return _table(folder / "twice.csv", header, [t_s, *_degrees(flight), some["front_V"], some["back_V"]])


def turns_wrapped(flight: Flight, folder: Path) -> Path:
    some = _slow(flight)
    elevation, pitch, travel = _degrees(flight)
    header = ["Time(s)", "El", "Pi", "Tr", "M1", "M2"]
    wrapped = np.mod(travel + 180.0, 360.0) - 180.0
    return _table(
        folder / "wrap.csv", header, [some["t_s"], elevation, pitch, wrapped, some["front_V"], some["back_V"]]
    )


def labview(flight: Flight, folder: Path) -> Path:
    some = _slow(flight)
    columns = [some["t_s"], *_degrees(flight), some["front_V"], some["back_V"]]
    path = _table(folder / "body.lvm", [], columns, "\t", comma=True)
    head = (
        "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\nDecimal_Separator\t,\n"
        "Multi_Headings\tNo\nX_Columns\tOne\nTime_Pref\tRelative\nDate\t2024/01/04\nTime\t12:58:31,25\n"
        "***End_of_Header***\t\n\nChannels\t5\nSamples\t1\t1\t1\t1\t1\n***End_of_Header***\t\n"
        "X_Value\tElevation\tPitch\tTravel\tFront\tBack\tComment\n"
    )
    path.write_text(head + path.read_text(encoding="utf-8"), encoding="utf-8")
    return path


def clipped_late(flight: Flight, folder: Path) -> Path:
    """Commands before the clip: now and then far beyond what acted."""
    some = _slow(flight)
    random = np.random.default_rng(1)
    volts = []
    for motor in ("front", "back"):
        item = some[f"{motor}_V"]
        wild = np.where(np.abs(item) >= 4.999, item * (1.0 + random.exponential(0.5, item.size)), item)
        volts.append(wild)
    header = ["t", "elevation_deg", "pitch_deg", "travel_deg", "Vf_cmd", "Vb_cmd"]
    return _table(folder / "cmd.csv", header, [some["t_s"], *_degrees(flight), *volts])


def all_turned(flight: Flight, folder: Path) -> Path:
    """Without names: elevation positive downwards, travel the other way, back motor first, no bias."""
    some = _slow(flight)
    elevation, pitch, travel = _degrees(flight)
    columns = [some["t_s"], some["back_V"], some["front_V"], -travel, pitch, -elevation]
    return _table(folder / "turned.txt", [], columns, " ")


FORMS: Final[dict[str, Form]] = {
    item.__name__: item
    for item in (
        *(norwegian, german, french, spanish, chinese, epsilon_theta, phi_theta, state_space),
        *(to_workspace, scope_with_labels, workspace_variables, series),
        *(serial_monitor, wrapped_counts, half_sums, half_sums_unnamed, crowded),
        *(before_and_after_calibration, clock_strings, dates, since_1970, trailing_zeros, logged_on),
        *(times_begin_again, turns_wrapped, labview, clipped_late, all_turned),
    )
}


def corrections(table: Table, guess_result: Guess, truth: Flight) -> tuple[str, ...]:
    """Name the entries of a guessed profile that are to be put right by hand, from the flight as it was."""
    other = replace(guess_result.profile, mirrored=not guess_result.profile.mirrored)
    return min(
        (_corrections(table, guess_result.profile, truth), _corrections(table, other, truth, ("mirrored",))),
        key=len,
    )


def _corrections(
    table: Table, profile: Profile, truth: Flight, more: tuple[str, ...] = ()
) -> tuple[str, ...]:
    flights = flights_of(table, profile)
    made = max(flights, key=len)
    # A piece of a file begins anywhere: what was at its times.
    start = float(made.t_s[0] - times_of(table.aligned(), profile)[0])
    t_s = np.minimum(made.t_s - made.t_s[0] + start, truth.t_s[-1])
    rows = np.clip(np.searchsorted(truth.t_s - truth.t_s[0], t_s + 1e-9, side="right") - 1, 0, None)
    inside = made.t_s - made.t_s[0] + start <= truth.t_s[-1]
    if not inside.any():
        return (*more, "time.unit")
    mistakes: list[str] = []
    for axis in _AXES:
        mine, true = getattr(made, f"{axis}_rad")[inside], getattr(truth, f"{axis}_rad")[rows][inside]
        mistakes += [f"{axis}.{what}" for what in _angle(mine, true, axis)]
    mine_V = np.column_stack((made.front_V, made.back_V))[inside]
    true_V = np.column_stack((truth.front_V, truth.back_V))[rows][inside]
    mistakes += _voltages(mine_V, true_V, "sum" in profile.voltages)
    return (*more, *mistakes)


def _angle(mine: Floats, true: Floats, axis: str) -> list[str]:
    slope, level = np.polyfit(mine, true, 1) if np.ptp(mine) > 0.0 else (0.0, 0.0)
    rest = float(np.std(true - slope * mine - level))
    if rest > 0.02 * float(np.std(true)):
        return ["column"]
    mistakes = []
    if slope < 0.0:
        mistakes.append("sign")
    if abs(abs(slope) - 1.0) > 0.02:
        mistakes.append(f"unit x {abs(slope):.3g}")
    off = float(np.degrees(np.mean(true - np.sign(slope) * mine)))
    far = {"elevation": 6.5, "pitch": 0.5, "travel": math.inf}[axis]
    if not mistakes and abs(off) > far:
        mistakes.append(f"offset {off:.1f}")
    return mistakes


def _voltages(mine: Floats, true: Floats, summed: bool) -> list[str]:
    if summed:
        to = np.array([[1.0, 1.0], [1.0, -1.0]])
        mine, true = mine @ to.T, true @ to.T
    names = ("sum", "difference") if summed else ("front", "back")
    best: list[str] | None = None
    for order in ((0, 1), (1, 0)):
        mistakes = [] if order == (0, 1) else [f"{name}.column" for name in names]
        for name, place, column in zip(names, order, true.T, strict=True):
            values = mine[:, place]
            slope, level = np.polyfit(values, column, 1) if np.ptp(values) > 0.0 else (0.0, 0.0)
            rest = float(np.std(column - slope * values - level))
            if rest > 0.15 * float(np.std(column)):
                mistakes.append(f"{name}.column")
                continue
            mistakes += [f"{name}.sign"] if slope < 0.0 else []
            mistakes += [f"{name}.unit x {abs(slope):.3g}"] if abs(abs(slope) - 1.0) > 0.05 else []
            off = abs(float(np.mean(column - np.sign(slope) * values)))
            if abs(abs(slope) - 1.0) <= 0.05 and off > 0.75:
                mistakes.append(f"{name}.offset_V {off:.2f}")
        best = mistakes if best is None or len(mistakes) < len(best) else best
    return best or []

"""Forms in which courses and programs write such flights, and the entries that a guess of them has wrong."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
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


def _cells(flight: Flight) -> dict[str, Floats]:
    """Every fifth row as columns: times, angles in radians, degrees and counts, voltages and their forms."""
    some = {name: getattr(flight, name)[::5] for name in ("t_s", "front_V", "back_V")}
    cells = {"t": some["t_s"], "ms": 1e3 * some["t_s"], "f": some["front_V"], "b": some["back_V"]}
    for letter, axis, turns in zip("epl", _AXES, (1, 1, 2), strict=True):
        angle = getattr(flight, f"{axis}_rad")[::5]
        counts = _COUNTS * turns / (2.0 * math.pi)
        cells |= {letter: angle, letter.upper(): angle * DEG, f"-{letter.upper()}": -angle * DEG}
        cells |= {f"{letter}#": np.round(angle * counts), f"{letter}16": np.round(angle * counts) % 65536.0}
        cells[f"{letter}0"] = np.round((angle - angle[0]) * counts)
    cells |= {f"{motor}pwm": np.round(cells[motor] / 10.0 * 255.0) for motor in "fb"}
    cells |= {"s/2": 0.5 * (cells["f"] + cells["b"]), "d/2": 0.5 * (cells["f"] - cells["b"])}
    cells["wrapped"] = np.mod(cells["L"] + 180.0, 360.0) - 180.0
    cells["arduino"] = 12345.0 + np.round(cells["ms"])
    random = np.random.default_rng(1)
    for motor in "fb":
        # Commands before the clip: now and then far beyond what acted.
        wild = cells[motor] * (1.0 + random.exponential(0.5, cells[motor].size))
        cells[f"{motor}cmd"] = np.where(np.abs(cells[motor]) >= 4.999, wild, cells[motor])
    return cells


@dataclass(frozen=True)
class TextForm:
    """Text as a program writes it; it is called like the functions below."""

    # `header`: Names of the columns, separated by ``|``; empty if the file has none.
    # `columns`: Keys of `_cells`, separated by blanks.

    file: str
    header: str
    columns: str
    separator: str = ","
    comma: bool = False
    encoding: str = "utf-8"

    def __call__(self, flight: Flight, folder: Path) -> Path:
        cells = _cells(flight)
        return self.write([cells[key] for key in self.columns.split()], folder / self.file)

    def write(self, columns: Sequence[Floats | Sequence[str]], path: Path) -> Path:
        """Write columns of numbers or texts."""
        lines = [self.header.replace("|", self.separator)] if self.header else []
        texts = [[item if isinstance(item, str) else f"{item:.9g}" for item in column] for column in columns]
        for row in zip(*texts, strict=True):
            text = self.separator.join(row)
            lines.append(text.replace(".", ",") if self.comma else text)
        path.write_text("\n".join(lines) + "\n", encoding=self.encoding)
        return path


TEXT_FORMS: Final = {
    "norwegian": TextForm(
        "norsk.csv",
        "Tid (s)|Høyde (grader)|Helling (grader)|Vandring (grader)|Foran (V)|Bak (V)",
        "t E P L f b",
        ";",
        comma=True,
    ),
    "german": TextForm(
        "deutsch.csv",
        "Zeit_ms|U_vorne|U_hinten|Höhenwinkel|Nickwinkel|Drehwinkel",
        "ms f b E P L",
        ";",
        comma=True,
        encoding="latin-1",
    ),
    "french": TextForm(
        "francais.csv",
        "Temps [s]|Élévation [°]|Tangage [°]|Rotation [°]|Moteur avant [V]|Moteur arrière [V]",
        "t E P L f b",
        "\t",
        comma=True,
    ),
    "spanish": TextForm("es.csv", "tiempo|elevacion|cabeceo|giro|v_delantero|v_trasero", "t e p l f b"),
    "chinese": TextForm(
        "gbk.csv",
        "时间(s)|高度角(°)|俯仰角(°)|旋转角(°)|前电机(V)|后电机(V)",
        "t E P L f b",
        encoding="gb18030",
    ),
    # In some books theta is the pitch, in others phi is the elevation.
    "epsilon_theta": TextForm("eps.csv", "t|epsilon|theta|psi|U1|U2", "t e p l f b"),
    "phi_theta": TextForm("phi.csv", "t|phi|theta|psi|Vf|Vb", "t e p l f b"),
    "serial_monitor": TextForm("putty.log.txt", "", "arduino e# p# l# fpwm bpwm"),
    "wrapped_counts": TextForm(
        "enc.csv", "time_ms|enc_elev|enc_pitch|enc_travel|Vf|Vb", "ms e16 p16 l16 f b"
    ),
    "half_sums": TextForm("half.csv", "t|travel|pitch|elevation|u_coll|u_diff", "t l p e s/2 d/2"),
    "before_and_after_calibration": TextForm(
        "cal.csv",
        "time|elev_raw|pitch_raw|travel_raw|elev_deg|pitch_deg|travel_deg|Vf|Vb",
        "t e0 p0 l0 E P L f b",
    ),
    "turns_wrapped": TextForm("wrap.csv", "Time(s)|El|Pi|Tr|M1|M2", "t E P wrapped f b"),
    "clipped_late": TextForm(
        "cmd.csv", "t|elevation_deg|pitch_deg|travel_deg|Vf_cmd|Vb_cmd", "t E P L fcmd bcmd"
    ),
    # Without names: elevation positive downwards, travel the other way, back motor first, no bias.
    "all_turned": TextForm("turned.txt", "", "t b f -L P -E", " "),
}


def state_space(flight: Flight, folder: Path) -> Path:
    header = "|".join(["t", *(f"x{i}" for i in range(1, 7)), "u1", "u2"])
    columns = [flight.t_s, *state_rows(flight), flight.front_V, flight.back_V]
    return TextForm("", header, "").write([column[::5] for column in columns], folder / "x.csv")


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


def clock_strings(flight: Flight, folder: Path) -> Path:
    cells = _cells(flight)
    at = [f"13:{int(t + 2840) // 60:02d}:{(t + 2840) % 60:06.3f}" for t in cells["t"]]
    form = TextForm("", "Time|Elevation|Pitch|Travel|Front|Back", "")
    return form.write([at, *(cells[key] for key in "EPLfb")], folder / "clock.csv")


def dates(flight: Flight, folder: Path) -> Path:
    cells = _cells(flight)
    start = np.datetime64("2024-01-04T12:58:31.250", "us")
    at = [str(start + np.timedelta64(round(t * 1e6), "us")).replace("T", " ") for t in cells["t"]]
    form = TextForm("", "timestamp|elevation|pitch|travel|front|back", "")
    return form.write([at, *(cells[key] for key in "EPLfb")], folder / "dates.csv")


def since_1970(flight: Flight, folder: Path) -> Path:
    cells = _cells(flight)
    at = [f"{1704373111.25 + t:.6f}" for t in cells["t"]]
    form = TextForm("", "stamp|state|elevation|pitch|travel|cmd_front|cmd_back", "")
    return form.write([at, ["FLY"] * len(at), *(cells[key] for key in "EPLfb")], folder / "ros.csv")


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
    cells = _cells(flight)
    t_s = cells["t"].copy()
    half = 2 * t_s.size // 3
    t_s[half:] -= t_s[half]
    form = TextForm("", "t|elevation_deg|pitch_deg|travel_deg|front_V|back_V", "")
    return form.write([t_s, *(cells[key] for key in "EPLfb")], folder / "twice.csv")


def labview(flight: Flight, folder: Path) -> Path:
    path = TextForm("body.lvm", "", "t E P L f b", "\t", comma=True)(flight, folder)
    head = (
        "LabVIEW Measurement\t\nWriter_Version\t2\nReader_Version\t2\nSeparator\tTab\nDecimal_Separator\t,\n"
        "Multi_Headings\tNo\nX_Columns\tOne\nTime_Pref\tRelative\nDate\t2024/01/04\nTime\t12:58:31,25\n"
        "***End_of_Header***\t\n\nChannels\t5\nSamples\t1\t1\t1\t1\t1\n***End_of_Header***\t\n"
        "X_Value\tElevation\tPitch\tTravel\tFront\tBack\tComment\n"
    )
    path.write_text(head + path.read_text(encoding="utf-8"), encoding="utf-8")
    return path


FORMS: Final[dict[str, Form]] = {
    **TEXT_FORMS,
    **{
        item.__name__: item
        for item in (
            *(state_space, to_workspace, scope_with_labels, workspace_variables, series, half_sums_unnamed),
            *(
                crowded,
                clock_strings,
                dates,
                since_1970,
                trailing_zeros,
                logged_on,
                times_begin_again,
                labview,
            ),
        )
    },
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

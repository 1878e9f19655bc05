"""Which column is what: elevation answers the voltages' sum, pitch their difference, travel the pitch."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from heli_host.arrays import Floats
from numpy.typing import NDArray

from heli_lab.guess import names, thresholds
from heli_lab.guess.reference import Reference
from heli_lab.guess.signals import Signal, Signals, late

_EVERY: Final = 10
"""Of the rows every so many is compared: ten a second say all that the filter leaves."""
_MOST_COLUMNS: Final = 14
_SAME: Final = 0.99999
_RATE_SCALES: Final = (
    *(1.0, 180.0 / np.pi, np.pi / 180.0),
    *(turn / counts for turn in (2.0 * np.pi, 360.0) for counts in (4096.0, 8192.0)),
)


@dataclass(frozen=True)
class RegressionFit:
    """An axis' acceleration, explained by a cause.

    Parameters
    ----------
    nats : float
        By how much the cause makes the axis likelier, less what the axis explains by itself.
    gain : float
        Acceleration for one unit of the cause; its sign tells which way they go.
    lag_s : float
        By how much the axis is late.
    """

    nats: float
    gain: float
    lag_s: float = 0.0


@dataclass(frozen=True)
class ColumnAssignment:
    """Columns by role.

    Parameters
    ----------
    elevation, pitch, travel : str
        Columns of the angles.
    voltages : tuple of (str, str)
        Columns of the voltages.
    summed : bool
        Whether these are sum and difference, not front and back.
    polarity : tuple of (float, float)
        Signs that make the voltages such as lift.
    nats : float
        Log-likelihood with names.
    physics : float
        The same without names.
    """

    elevation: str
    pitch: str
    travel: str
    voltages: tuple[str, str]
    summed: bool
    polarity: tuple[float, float]
    nats: float
    physics: float

    @property
    def columns(self) -> tuple[str, ...]:
        """All five columns."""
        return (self.elevation, self.pitch, self.travel, *self.voltages)

    def same_as(self, other: ColumnAssignment) -> bool:
        """Whether another assignment means the same, motors in either order."""
        pair = set if not self.summed else tuple
        return (self.columns[:3], self.summed, pair(self.voltages)) == (
            other.columns[:3],
            other.summed,
            pair(other.voltages),
        )


def explain(
    acceleration: Floats,
    own_terms: tuple[Floats, Floats],
    cause: Floats,
    stiffness: tuple[float, float],
    rows: NDArray[np.bool_],
) -> RegressionFit:
    """Explain an axis by a cause, beside its own stiffness and damping.

    Parameters
    ----------
    acceleration : ndarray (n,)
        Of the axis.
    own_terms : tuple of ndarray (n,)
        Its deflection and its rate.
    cause : ndarray (n,)
        What may move it.
    stiffness : tuple of float
        Prior of its acceleration for a deflection: mean and standard deviation, 1/s2.
    rows : ndarray of bool (n,)
        Rows that count.
    """
    y = acceleration[rows][::_EVERY] - stiffness[0] * own_terms[0][rows][::_EVERY]
    if len(y) < 20:
        return RegressionFit(0.0, 0.0)
    columns = np.column_stack(
        [own_terms[0][rows][::_EVERY], own_terms[1][rows][::_EVERY], np.ones(len(y)), cause[rows][::_EVERY]]
    )
    spread = np.maximum(columns.std(axis=0), 1e-12)
    spread[2] = 1.0
    columns = columns / spread
    ridge = np.array([stiffness[1], 1.0, np.inf, np.inf]) * spread
    # Thousands of these are solved for each file: of the normal equations, not of all rows.
    gram, moment, power = columns.T @ columns, columns.T @ y, float(y @ y)
    noise = float(y.var())
    rests: list[float] = []
    gain = 0.0
    for _ in range(3):
        rests = []
        for count in (3, 4):
            penalised = gram[:count, :count] + np.diag(noise / ridge[:count] ** 2 + 1e-9 * len(y))
            solution = np.linalg.solve(penalised, moment[:count])
            # At the solution, squares of residuals and penalty together.
            rests.append((power - float(solution @ moment[:count])) / len(y))
            gain = float(solution[-1] / spread[count - 1])
        noise = max(rests[1], 1e-12 * float(y.var()) + 1e-300)
    seconds = len(y) * _EVERY * thresholds.STEP_S
    independent = seconds * thresholds.INDEPENDENT_Hz
    return RegressionFit(
        0.5 * independent * float(np.log(max(rests[0], 1e-300) / max(rests[1], 1e-300))), gain
    )


def free_rows(signals: Signals, name: str) -> NDArray[np.bool_]:
    """Rows in which the column `name`, taken for the elevation, is off the level at which it begins, where it
    begins at rest; all inner ones where it does not.
    """
    raw = signals.raw[name]
    rest = round(thresholds.REST_S / thresholds.STEP_S)
    start, usual = float(raw[0]), float(np.median(raw))
    span = float(np.ptp(raw))
    if span == 0.0 or np.ptp(raw[:rest]) > 0.01 * span or abs(usual - start) < 0.2 * span:
        return signals.inner
    off = (raw - start) * np.sign(usual - start) > 0.4 * abs(usual - start)
    free: NDArray[np.bool_] = signals.inner & off
    return free


def candidates(signals: Signals, encoders: Collection[str] = frozenset()) -> list[str]:
    """Columns that may be an angle or a voltage: those that vary, without rates and doubles, of which
    one of `encoders` stays.
    """
    moving = [name for name, values in signals.raw.items() if np.ptp(values) > 0.0]
    moving.sort(key=lambda name: (name not in encoders, not names.role_of(name), names.is_other(name)))
    kept: list[str] = []
    for name in moving:
        if not any(_alike(signals.raw[name], signals.raw[other]) > _SAME for other in kept):
            kept.append(name)
    rates = _rates(signals, kept) - set(encoders)
    return [name for name in kept if name not in rates][:_MOST_COLUMNS]


def _rates(signals: Signals, columns: list[str]) -> set[str]:
    """Columns that are the rate of a column that is none itself: the rate of travel's rate looks like pitch,
    which moves it, and that of pitch's rate like a voltage.
    """
    pairs = {}
    for name, other in itertools.permutations(columns, 2):
        rate, value = signals.filtered[other].rate, signals.filtered[name].value
        likeness = _alike(rate, value)
        if not names.role_of(name) and likeness > thresholds.RATE_MATCH**0.5 and _unit_slope(rate, value):
            pairs[name, other] = likeness
    rates: set[str] = set()
    settled: set[str] = set()
    remaining = set(columns)
    while remaining:
        open_ = {name for name in remaining if all(of in settled for first, of in pairs if first == name)}
        if not open_:  # each is the rate of another one, as sines are: the least alike is none
            weakest = min((likeness, name) for (name, _), likeness in pairs.items() if name in remaining)[1]
            open_ = {weakest}
            pairs = {pair: similarity for pair, similarity in pairs.items() if pair[0] != weakest}
        rates |= {name for name in open_ if any(first == name and of not in rates for first, of in pairs)}
        settled |= open_
        remaining -= open_
    return rates


def _unit_slope(rate: Floats, value: Floats) -> bool:
    """Whether a `value` is a `rate` in the same unit, or in degrees or radians of another one; or counts the
    other way, where its angle was turned later.
    """
    variance = float(rate.var())
    slope = float(np.mean((rate - rate.mean()) * (value - value.mean()))) / variance if variance else 0.0
    return any(0.6 < abs(slope) / scale < 1.5 for scale in _RATE_SCALES)


def _alike(first: Floats, second: Floats) -> float:
    if np.ptp(first) == 0.0 or np.ptp(second) == 0.0:
        return 0.0
    return abs(float(np.corrcoef(first, second)[0, 1]))


def polarity_of(values: Floats) -> float:
    """Sign that makes a voltage, `values`, one that lifts on the mean; 1 where the mean says nothing."""
    mean = float(values.mean())
    return -1.0 if mean < 0.0 and abs(mean) > 0.5 * float(values.std()) else 1.0


def assignments(
    signals: Signals, reference: Reference, encoders: Collection[str] = frozenset()
) -> list[ColumnAssignment]:
    """All assignments of columns to roles, the likeliest first.

    Parameters
    ----------
    signals : Signals
        The columns.
    reference : Reference
        What the rig's model says of stiffness.
    encoders : collection of str
        Columns in steps of an encoder: angles as measured, not as estimated or wanted.
    """
    candidates_ = candidates(signals, encoders)
    count = len(candidates_)
    if count < 5:
        return []
    filtered = [signals.filtered[name] for name in candidates_]
    rows = [free_rows(signals, name) for name in candidates_]
    polarity = np.array([polarity_of(signals.raw[name]) for name in candidates_])
    level = [polarity[i] * filtered[i].value for i in range(count)]
    pairs = list(itertools.combinations(range(count), 2))
    sums: dict[tuple[int, ...], Floats] = {(i,): level[i] for i in range(count)}
    sums |= {(i, j): level[i] + level[j] for i, j in pairs}
    differences: dict[tuple[int, ...], Floats] = {(i,): filtered[i].value for i in range(count)}
    differences |= {(i, j): level[i] - level[j] for i, j in pairs}
    lifted = _table(sums, filtered, rows, reference.stiffness["elevation"])
    pitched = _table(differences, filtered, [signals.inner] * count, reference.stiffness["pitch"])
    turned = np.zeros((count, count))
    for p, t in itertools.permutations(range(count), 2):
        own_terms = (filtered[t].value * 0.0, filtered[t].rate)
        turned[p, t] = explain(
            filtered[t].acceleration, own_terms, filtered[p].value, (0.0, 0.1), signals.inner
        ).nats
    measured = thresholds.ENCODER_NATS * np.array([name in encoders for name in candidates_], float)
    lifted = {key: nats + measured for key, nats in lifted.items()}
    pitched = {key: nats + measured for key, nats in pitched.items()}
    turned += measured
    stated = _stated(candidates_)
    ranked = []
    for pair in pairs:
        ranked += _best(candidates_, lifted[pair], pitched[pair], turned, pair, False, polarity, stated)
    for pair in itertools.permutations(range(count), 2):
        ranked += _best(
            candidates_, lifted[pair[:1]], pitched[pair[1:]], turned, pair, True, polarity, stated
        )
    return sorted(ranked, key=lambda assignment: -assignment.nats)


def _table(
    causes: dict[tuple[int, ...], Floats],
    filtered: Sequence[Signal],
    rows: list[NDArray[np.bool_]],
    stiffness: tuple[float, float],
) -> dict[tuple[int, ...], Floats]:
    """Nats of each column, explained by each cause at its best lag; none where a column is its own cause."""
    table = {}
    for key, cause in causes.items():
        lagged = [late(cause, lag_s) for lag_s in thresholds.ROLE_LAGS_S]
        nats = np.zeros(len(filtered))
        for index, signal in enumerate(filtered):
            if index in key:
                continue
            own_terms = (signal.value - signal.value.mean(), signal.rate)
            nats[index] = max(
                explain(signal.acceleration, own_terms, each, stiffness, rows[index]).nats for each in lagged
            )
        table[key] = nats
    return table


def _stated(columns: list[str]) -> dict[str, Floats]:
    """What names count for each role, by column."""
    stated = {}
    for role in names.ROLES:
        worth = np.zeros(len(columns))
        for index, name in enumerate(columns):
            named_role = names.role_of(name)
            if named_role == role:
                worth[index] = thresholds.NAME_NATS
            elif named_role:
                worth[index] = -thresholds.NAME_NATS
            elif names.is_other(name):
                worth[index] = -thresholds.OTHER_NATS
        stated[role] = worth
    return stated


def _best(
    columns: list[str],
    lifted: Floats,
    pitched: Floats,
    turned: Floats,
    pair: tuple[int, int],
    summed: bool,
    polarity: Floats,
    stated: dict[str, Floats],
) -> list[ColumnAssignment]:
    """The three likeliest choices of angles for a pair of voltages."""
    physics = lifted[:, None, None] + pitched[None, :, None] + turned[None, :, :]
    words = (
        stated["elevation"][:, None, None] + stated["pitch"][None, :, None] + stated["travel"][None, None, :]
    )
    i, j = pair
    if summed:
        words = words + stated["sum"][i] + stated["difference"][j]
    else:
        orders = (stated["front"][i] + stated["back"][j], stated["front"][j] + stated["back"][i])
        words = words + max(orders)
        if orders[1] > orders[0]:
            i, j = j, i
    total = physics + words
    count = len(columns)
    e, p, t = np.indices((count, count, count))
    total[(e == p) | (e == t) | (p == t)] = -np.inf
    for column in pair:
        total[(e == column) | (p == column) | (t == column)] = -np.inf
    ranked = []
    for flat in np.argsort(total.ravel())[::-1][:3]:
        a, b, c = (int(x) for x in np.unravel_index(flat, total.shape))
        if np.isfinite(total[a, b, c]):
            signs = (float(polarity[i]), 1.0 if summed else float(polarity[j]))
            ranked.append(
                ColumnAssignment(
                    columns[a],
                    columns[b],
                    columns[c],
                    (columns[i], columns[j]),
                    summed,
                    signs,
                    float(total[a, b, c]),
                    float(physics[a, b, c]),
                )
            )
    return ranked

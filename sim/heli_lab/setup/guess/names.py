"""Read the name of a column: it may state a role, such as pitch, or another quantity, such as a setpoint."""

from __future__ import annotations

import itertools
import re
import unicodedata
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

from heli_host.data.tables.table import (
    ANGLE_UNITS,
    COUNT,
    SHARES,
    VOLTAGE_UNITS,
    split_unit,
    unit_of,
    unknown_unit,
)

AXES: Final = ("elevation", "pitch", "travel")
PAIR: Final = ("front", "back")
SUMS: Final = ("sum", "difference")
VOLTAGE_ROLES: Final = (*PAIR, *SUMS)
ROLES: Final = (*AXES, *VOLTAGE_ROLES)

A_SUPPLY: Final = "a supply voltage"
A_DIRECTION: Final = "a direction"
A_COUNTER: Final = "a counter"
PULSES: Final = "a time or a width of pulses"
_WORDS: Final = {
    "elevation": (
        *("elevation", "elev", "theta", "epsilon", "eps", "el", "e"),
        *("elevasjon", "hoyde", "hoydevinkel", "elevacion", "altura", "高度", "升降"),
        *("hohe", "hohen", "hohenwinkel", "hoehe", "hoehen", "hoehenwinkel", "steigwinkel"),
        *("elevazione", "elevacao", "elevatie", "elewacja", "elevace", "hojd"),
        *("hoogte", "podniesienie", "yukselis", "yukselme"),
        *("仰角", "昇降", "エレベーション", "возвышен", "элевац", "угол места", "подъем", "고도", "고각"),
    ),
    "pitch": (
        *("pitch", "phi", "rho", "p", "tilt", "pit"),
        *("helling", "stigning", "nick", "nicken", "nickwinkel", "neigung", "tangage", "cabeceo", "俯仰"),
        *(
            "beccheggio",
            "arfagem",
            "pochylenie",
            "naklon",
            "inclinacion",
            "inclinacao",
            "inclinazione",
            "inclinaison",
            "stampfen",
            "stamphoek",
            "yunuslama",
            "ピッチ",
            "тангаж",
            "피치",
        ),
    ),
    "travel": (
        *("travel", "trav", "psi", "lambda", "lam", "lamda", "yaw", "azimuth", "heading", "tr"),
        *("vandring", "dreh", "drehwinkel", "gier", "gieren", "gierwinkel", "azimut", "schwenk"),
        *("schwenkwinkel", "lacet", "rotation", "giro", "desplazamiento", "deplacement", "旋转", "巡航"),
        *("spostamento", "deslocamento", "verplaatsing", "traslazione", "obrot", "viaje"),
        *("azimute", "guinada", "percurso", "recorrido", "imbardata", "draaihoek", "azymut", "sapma"),
        *("旅行", "行程", "偏航", "方位", "旋回", "トラベル", "ヨー", "азимут", "рыскан", "поворот"),
        *("이동", "선회", "방위", "트래블"),
    ),
    "front": (
        *("front", "vf", "uf", "uv", "forward", "fwd", "mf", "f"),
        *("foran", "fremme", "vorne", "vorn", "vorderer", "avant", "delantero", "前"),
        *("anteriore", "frontal", "dianteiro", "dianteira", "frente", "voor", "przod", "przedni", "predni"),
        *("передн", "앞", "전방"),
    ),
    "back": (
        *("back", "rear", "vb", "ub", "uh", "aft", "mb", "b", "vr", "ur", "mr"),
        *("bak", "bakre", "hinten", "hinterer", "heck", "arriere", "trasero", "后"),
        *("posteriore", "traseiro", "traseira", "tras", "achter", "tyl", "tylny", "zadni"),
        *("後", "задн", "뒤", "후방"),
    ),
    "sum": ("sum", "vs", "us", "collective", "coll", "total", "vsum", "summe", "somme", "suma", "сумм"),
    "difference": (
        *("difference", "diff", "vd", "ud", "differential", "vdiff", "delta"),
        *("differanse", "differenz", "diferencia", "разност"),
    ),
}
"""Words for each role, without accents: English, Greek letters, Norwegian, German, French, Spanish, Italian,
Portuguese, Dutch, Polish, Czech, Chinese, Japanese, Russian and Korean; in other scripts than the Latin one
the stems of words. In German, vorne and hinten are abbreviated to v and h."""
_OTHER_QUANTITIES: Final = {
    "a setpoint": (
        *("ref", "reference", "setpoint", "set", "sp", "des", "desired", "cmd", "command", "target", "goal"),
        *("demand", "demanded", "commanded", "star", "opt", "c", "r", "joy", "joystick", "stick"),
        *("soll", "sollwert", "vorgabe", "fuhrung", "referenz", "referanse", "onsket", "settpunkt"),
        *("consigne", "cible", "consigna", "referencia", "deseado"),
        *("目标", "目標", "给定", "期望", "参考", "指令", "設定", "задан", "уставк", "목표", "기준", "명령"),
    ),
    "a setpoint or a rate": ("d",),
    "a rate": (
        *("rate", "dot", "vel", "velocity", "speed", "gyro", "omega", "d1", "derivative", "deriv", "dt"),
        *("geschwindigkeit", "geschw", "drehrate", "punkt", "ableitung", "hastighet", "derivert"),
        *("vitesse", "velocidad", "derivada", "速度", "速率", "角速", "скорост", "속도"),
    ),
    "an acceleration": (
        *("acc", "accel", "acceleration", "beschleunigung", "akselerasjon", "ddot"),
        *("加速", "ускорен", "가속"),
    ),
    "an estimate": (
        *("hat", "est", "estimate", "estimated", "filtered", "filt", "filter", "smoothed", "smooth"),
        *("lowpass", "low", "lp", "lpf", "kalman", "ekf", "observer", "f"),
        *("gefiltert", "geglattet", "beobachter", "filtrert", "filtre", "filtree", "filtrado", "filtrada"),
        *("滤波", "估计", "フィルタ", "推定", "平滑", "фильтр", "оценк", "필터", "추정"),
    ),
    "an error": (
        *("err", "error", "fehler", "abweichung", "avvik", "feil", "erreur", "deviation"),
        *("误差", "誤差", "偏差", "ошибк", "рассоглас", "오차"),
    ),
    "an integral": ("integral", "int"),
    "a feed-forward": ("ff", "feedforward", "vorsteuerung", "foroverkobling"),
    "a current": (
        *("current", "curr", "amps", "ampere", "i", "if", "ib", "ih", "im", "isense"),
        *("strom", "motorstrom", "courant", "corriente", "电流", "電流", "ток", "전류"),
    ),
    A_SUPPLY: (
        *("supply", "battery", "batt", "bat", "vbat", "vbatt", "ubat", "vcc", "vdd", "vbus", "vin", "lipo"),
        *("akku", "batterie", "versorgung", "versorgungsspannung", "batteri", "batterispenning"),
        *("forsyning", "forsyningsspenning", "alimentation", "alimentacion", "bateria"),
        *("电池", "电源", "電池", "電源", "バッテリ", "питан", "батаре", "аккумулят", "배터리", "전원"),
    ),
    A_DIRECTION: (
        *("dir", "direction", "sign", "polarity"),
        *("richtung", "drehrichtung", "vorzeichen", "retning", "sens", "direccion"),
        *("方向", "направлен", "방향"),
    ),
    "a quaternion": ("quaternion", "quat", "qw", "qx", "qy", "qz"),
    "another sensor": ("imu", "ahrs", "mpu", "mems", "inertial", "camera", "mocap"),
    "another quantity": (
        *(
            "state",
            "mode",
            "fault",
            "flags",
            "status",
            "count2",
            "temp",
            "temperature",
            "temperatur",
            "ambient",
            "amb",
        ),
        *("force", "lift", "kraft", "auftrieb", "fuerza", "forza", "forca", "poussee", "empuje"),
        *("rpm", "thrust", "torque", "schub", "drehmoment", "dreiemoment", "cpu"),
        *("状态", "状態", "モード", "温度", "转速", "回転数", "推力", "состоян", "режим", "температур"),
        *("оборот", "частот", "тяг", "상태", "온도", "회전수", "추력"),
    ),
}
"""Words of quantities that are neither a measured angle nor a motor's voltage."""
_GROUP: Final = "state"
"""Word before the role in the name of a measured value; after it, as in ``pitch_state``, it means a mode."""
_COUNTERS: Final = frozenset(
    {
        *("seq", "sequence", "idx", "index", "counter", "loop", "iteration", "iter", "sample", "samples"),
        *("row", "frame", "nr", "no", "zaehler", "zahler", "teller", "compteur", "contador"),
    }
)
"""Words of a counter of rows. Next to an angle they mean the counter of its encoder."""
_LETTERS: Final = frozenset({"c", "i", "d", "f"})
"""Words of `_OTHER_QUANTITIES` that only count next to a role, as in ``e_c``."""
_ROLLS: Final = frozenset(
    {"roll", "rollen", "rollwinkel", "roulis", "rull", "alabeo", "横滚", "滚转", "ロール", "крен", "롤"}
)
"""Words of the pitch of the rig, if its axes are called as those of an aircraft."""
_ANGLE_LETTERS: Final = frozenset({"d", "f"})
"""Letters that only count next to an angle: in ``V_f`` and ``V_d`` they name the voltage."""
_COMMANDS: Final = frozenset({"set", "cmd", "command", "commanded", "target", "goal", "opt", "star", "c"})
"""Words of setpoints that a motor's voltage may have: commands are voltages before their limit."""
_MEASURED: Final = frozenset(
    {
        *("measured", "meas", "real", "actual", "act", "encoder", "enc", "raw", "true"),
        *(
            "ist",
            "istwert",
            "gemessen",
            "malt",
            "mesure",
            "medido",
            "实际",
            "测量",
            "実測",
            "измерен",
            "측정",
        ),
    }
)
_VOLTAGES: Final = frozenset(
    {
        *("u", "v", "m", "motor", "volt", "voltage", "input", "pwm", "duty"),
        *("spannung", "spenning", "spanning", "tension", "tensione", "tensao", "voltaje"),
        *("tastgrad", "padrag", "stellgrosse", "电压", "電圧", "モータ", "电机", "напряжен", "двигател"),
        *("мотор", "전압", "모터"),
    }
)
"""Words of the voltage of a motor that is not named, as in ``u1`` or ``motor_2``."""
_SIDES: Final = frozenset(
    {"l", "r", "left", "right", "links", "rechts", "gauche", "droite", "izquierdo", "derecho"}
)
"""Words of a motor by its side, as in ``pwmR``: they do not state which motor is the front one."""
_SIDE_LETTERS: Final = frozenset({"vl", "ul", "ml"})
_DUTIES: Final = frozenset({"pwm", "duty", "tastgrad", "padrag", "percent", "prozent", "prosent"})
"""Words of a share of the supply voltage."""
_GERMAN_LETTERS: Final = {"v": "vorne", "h": "hinten"}
_HALVES: Final = frozenset({"mean", "avg", "average", "half", "mid", "middle", "mittel", "halb"})
"""Words of half a sum, or half a difference, of two voltages."""
_TIMES: Final = frozenset(
    {
        *("t", "time", "times", "timestamp", "stamp", "date", "datum", "fecha"),
        *("tid", "zeit", "temps", "tiempo", "tempo", "tijd", "czas", "cas", "zaman", "时间", "時間", "時刻"),
        *("врем", "시간", "χρον"),
        *("millis", "micros", "clock", "tout", "seconds", "elapsed", "zeitstempel", "uhrzeit", "tidspunkt"),
    }
)
_OTHER_UNITS: Final = {
    "deg/s": "a rate",
    "rad/s": "a rate",
    "rad/s2": "an acceleration",
    "A": "a current",
    "mA": "a current",
    "°C": "another quantity",
    "rpm": "another quantity",
    "N": "another quantity",
    "W": "another quantity",
    "Nm": "another quantity",
    "us": PULSES,
    "ms": PULSES,
}
"""Quantities by units that neither an angle nor a voltage has."""
_SPLIT: Final = re.compile(r"[^a-z0-9\u4e00-\u9fff]+|(?<=[a-z])(?=\d)|(?<=\d)(?!(?<=3)d(?![a-z]))(?=[a-z])")
"""What separates words; the d of 3D, as in ``heli3d/pitch``, is no derivative."""
_PATH: Final = re.compile(r"[./:]")
"""What separates the name of a signal from the names of the messages or structures that contain it."""
_INDEX: Final = re.compile(r"\d+")
_ELEMENT: Final = re.compile(r"[\[(]\d+[\])]$")
_CAMEL: Final = re.compile(r"(?<=[a-z])(?=[A-Z])")
_GREEK: Final = str.maketrans(
    {
        "ε": " epsilon ",
        "θ": " theta ",
        "φ": " phi ",
        "ψ": " psi ",
        "λ": " lambda ",
        "ρ": " rho ",
        "ω": " omega ",
    }
)
"""Greek letters of angles; a letter is a word."""
_DERIVATIVES: Final = (
    (re.compile("(?<=[α-ω])\u0308"), " ddot "),
    (re.compile(r"(?<=[α-ω])\u0307|(?<=(?<![^\W_])[a-hj-z])\u0307(?![^\W_])"), " dot "),
    (re.compile(r"(?<=[α-ω])\u0302|(?<=(?<![^\W_])[a-z])\u0302(?![^\W_])"), " hat "),
)
"""Marks above a letter that is a symbol: points of a derivative, and the hat of an estimate. Above letters of
words they are accents."""
_MIN_PART: Final = 4
"""Fewest letters of a word within a compound, as in ``Nickwinkelgeschwindigkeit``; shorter ones are within
many other words."""
_MIN_REST: Final = 3
_PARTS: Final = frozenset(
    word
    for known in (*_WORDS.values(), *_OTHER_QUANTITIES.values(), _MEASURED, _VOLTAGES)
    for word in known
    if len(word) >= _MIN_PART
)


@dataclass(frozen=True)
class ColumnMeaning:
    """Role or quantity that the name and the unit of a column state."""

    role: str = ""  # One of `ROLES`; empty if they state none
    quantity: str = ""
    """The quantity, such as ``a setpoint``, if it is no measured angle and no voltage; otherwise empty."""
    is_measured: bool = False  # Whether the name states that the value was measured
    possible_roles: tuple[str, ...] = ()  # Roles that name and unit permit


_NO_MEANING: Final = ColumnMeaning(possible_roles=ROLES)


def meanings_of(units: Mapping[str, str]) -> dict[str, ColumnMeaning]:
    """Return the meanings of the columns of a table, from their names and the units that the file states.

    The name of a single matrix, in ``data[1]`` and ``data[2]``, states nothing about its columns.
    """
    if len(units) > 1 and len({_INDEX.sub("", name) for name in units}) == 1:
        return {name: ColumnMeaning(possible_roles=ROLES) for name in units}
    meanings = {name: meaning_of(name, unit) for name, unit in units.items()}
    meanings = _without_shared_motors(_without_shared_words(meanings))
    return _without_duties_of_voltages(_with_rolls(meanings), units)


def _without_shared_motors(meanings: Mapping[str, ColumnMeaning]) -> dict[str, ColumnMeaning]:
    """Return the meanings of a table in which one matrix with the name of a motor has two columns, as in
    ``Vf[1]`` and ``Vf[2]``: they are the voltages of both motors, and the name does not state which is which.
    """
    result = dict(meanings)
    for motor in PAIR:
        columns = [name for name, each in meanings.items() if each.role == motor and not each.quantity]
        others = [
            name for name, each in meanings.items() if each.role in VOLTAGE_ROLES and each.role != motor
        ]
        matrices = {_ELEMENT.sub("", name) for name in columns}
        if len(columns) == len(PAIR) and len(matrices) == 1 and not others and columns[0] not in matrices:
            result |= dict.fromkeys(columns, ColumnMeaning(possible_roles=VOLTAGE_ROLES))
    return result


def _without_shared_words(meanings: Mapping[str, ColumnMeaning]) -> dict[str, ColumnMeaning]:
    """Return the meanings of a table whose angles share one word, as in `theta_e`, `theta_p` and `theta_t`.

    This word only means an angle, although alone it would mean one axis. The others distinguish the axes; a
    word that is unknown means the third one.
    """
    result = dict(meanings)
    for axis in AXES:
        columns = [
            name for name, meaning in meanings.items() if meaning.role == axis and not meaning.quantity
        ]
        words = {name: words_of(name) for name in columns}
        shared = set.intersection(*map(set, words.values())) if len(columns) > 1 else set()
        roles = {name: _stated_role([word for word in words[name] if word not in shared]) for name in columns}
        stated = {role for role in roles.values() if role in AXES}
        others = [other for other in AXES if other not in stated]
        if len(stated) < 2:
            continue  # the other words do not distinguish the axes
        unknown = [set(words[name]) - shared for name, role in roles.items() if role not in AXES]
        if len(others) == 1 and unknown and set.intersection(*unknown):
            roles = {name: role if role in AXES else others[0] for name, role in roles.items()}
        for name, role in roles.items():
            possible = (role,) if role else AXES
            result[name] = replace(meanings[name], role=role, possible_roles=possible)
    return result


def _with_rolls(meanings: Mapping[str, ColumnMeaning]) -> dict[str, ColumnMeaning]:
    """Return the meanings of a table whose axes may be called pitch, roll and yaw, as those of an aircraft.

    The arm then pitches, and the body with the rotors rolls.
    """
    rolls = {name for name in meanings if _ROLLS.intersection(words_of(name))}
    stated = {meaning.role for meaning in meanings.values()}
    if not rolls or {"elevation", "pitch"} <= stated:
        return dict(meanings)
    result = {}
    for name, meaning in meanings.items():
        role = "elevation" if meaning.role == "pitch" and "elevation" not in stated else meaning.role
        role = "pitch" if name in rolls else role
        possible = (role,) if role and not meaning.quantity else meaning.possible_roles
        result[name] = replace(meaning, role=role, possible_roles=possible)
    return result


def _without_duties_of_voltages(
    meanings: Mapping[str, ColumnMeaning], units: Mapping[str, str]
) -> dict[str, ColumnMeaning]:
    """Mark the duty of a motor as another quantity if its voltage is logged, too."""
    duties = {name for name in meanings if _is_duty(name, units[name])}
    stated = {
        meaning.role for name, meaning in meanings.items() if name not in duties and not meaning.quantity
    } - {""}
    return {
        name: ColumnMeaning(meaning.role, "a duty, and the voltage is logged")
        if name in duties and meaning.role in VOLTAGE_ROLES and meaning.role in stated
        else meaning
        for name, meaning in meanings.items()
    }


def _is_duty(name: str, unit: str) -> bool:
    """Whether name or unit of a column state a share of the supply."""
    return (unit or split_unit(name)[1]) in SHARES or bool(_DUTIES.intersection(words_of(name)))


def meaning_of(name: str, unit: str = "") -> ColumnMeaning:
    """Return what the name of a column, and the `unit` that the file states, mean."""
    words = words_of(name)
    role = _stated_role(words)
    # A bar means a share of the supply, or that the unit of an angle is not stated.
    unit = unit if unit and not (unit == "duty" and role in AXES) else split_unit(name)[1]
    quantity = _OTHER_UNITS.get(unit, "") or _stated_quantity(words, role)
    if not role and _is_current(name):
        quantity = "a current"
    if quantity:
        return ColumnMeaning(role, quantity)
    if unit in VOLTAGE_UNITS or unit in SHARES:
        possible: tuple[str, ...] = VOLTAGE_ROLES
    elif unit in ANGLE_UNITS or unit == COUNT:
        possible = AXES
    else:
        possible = ROLES
    if role in possible:
        # A raw voltage is a command before its limit.
        measuring = _MEASURED - {"raw"} if role in VOLTAGE_ROLES else _MEASURED
        return ColumnMeaning(role, "", bool(measuring.intersection(words)), (role,))
    bare = {word for word in words if not any(char.isdigit() for char in word)}
    if possible == ROLES and _VOLTAGES.intersection(bare) and bare <= _VOLTAGES | _SIDES | _SIDE_LETTERS:
        possible = VOLTAGE_ROLES
    return ColumnMeaning("", "", bool(_MEASURED.intersection(words)), possible)


def _is_current(name: str) -> bool:
    """Whether a `name` is that of a current of a motor that is not named, such as ``i1`` or ``logs.i1_A``."""
    words = {word for word in words_of(_PATH.split(split_unit(name)[0])[-1]) if not word.isdigit()}
    return "i" in words and words <= {"i", "a", "ma"}


def is_other_script(word: str) -> bool:
    """Whether a `word` is in another script than the Latin one; Greek is the first of these in Unicode."""
    return word[0] > "\u0370"


def _without_accents(text: str) -> str:
    """Return a `text` in lower case with plain letters; Greek letters become their names."""
    plain = unicodedata.normalize("NFKD", text.lower().replace("ø", "o").replace("ł", "l"))
    for mark, word in _DERIVATIVES:
        plain = mark.sub(word, plain)
    return "".join(char for char in plain if not unicodedata.combining(char)).translate(_GREEK)


_STEMS: Final = {
    _without_accents(word): word
    for known in (*_WORDS.values(), *_OTHER_QUANTITIES.values(), _ROLLS, _MEASURED, _VOLTAGES, _TIMES)
    for word in known
    if is_other_script(word)
}
"""Words of other scripts than the Latin one, by their plain letters: they have endings, or no spaces between
them."""
_STEM: Final = re.compile("|".join(sorted(map(re.escape, _STEMS), key=len, reverse=True)))


def words_of(name: str) -> list[str]:
    """Split a column's `name`, without its unit, into lower-case words."""
    plain = _without_accents(_CAMEL.sub("_", split_unit(name)[0]))
    words = [word for word in _SPLIT.split(plain) if word]
    words += [part for word in words for part in _parts_of(word)]
    words += [_STEMS[stem] for stem in _STEM.findall(plain)]
    pairs = list(itertools.pairwise(words))
    # In v_f, v s and u_d the letter of the voltage belongs to the next word.
    joined_pairs = [a + b for a, b in pairs if a in {"v", "u", "m"} and len(b) == 1]
    # In PWM_v and I_h the letters are those of vorne and hinten.
    joined_pairs += [_GERMAN_LETTERS[b] for a, b in pairs if a in _VOLTAGES | {"i"} and b in _GERMAN_LETTERS]
    return words + joined_pairs


def _parts_of(word: str) -> list[str]:
    """Return the known words at the beginning and at the end of a compound; empty for a known word.

    A derivative may begin with a d, as in ``dpitch``.
    """
    if word in _PARTS or word in _TIMES or word in _COUNTERS:
        return []
    if word[0] == "d" and len(word) > _MIN_PART and word[1:] in _PARTS:
        return ["dot", word[1:]]
    # The rest of a compound is a word, too: ``wpitch`` is none.
    parts = [
        part
        for part in _PARTS
        if (word.startswith(part) or word.endswith(part)) and len(word) >= len(part) + _MIN_REST
    ]
    # Of two words at the same place, the longer one is meant.
    return [part for part in parts if not any(part != other and part in other for other in parts)]


def _stated_role(words: list[str]) -> str:
    """Return the role that the words of a name state; a longer word counts more than a single letter."""
    stated = {role for role, known in _WORDS.items() if any(word in known for word in words)}
    # One or two letters, such as p, often have another meaning.
    distinctive = {
        role
        for role in stated
        if any(word in _WORDS[role] and (len(word) > 2 or is_other_script(word)) for word in words)
    }
    candidates = distinctive or stated
    # Next to another role, the letter p means something else, such as a position.
    if "pitch" in candidates and len(candidates) > 1 and not distinctive:
        candidates.discard("pitch")
    return candidates.pop() if len(candidates) == 1 else ""


def _stated_quantity(words: list[str], role: str) -> str:
    """Return the quantity other than an angle or a voltage that the words state; empty if they state none."""
    if role in PAIR and words[0] == "f" and any(len(word) > 2 and word in _WORDS[role] for word in words):
        return "a force"
    is_voltage = bool(_VOLTAGES.intersection(words)) and role not in AXES
    named = [word for word in words if not word.isdigit()]
    names_side = is_voltage and all(word in _VOLTAGES | _SIDES or word in _WORDS["back"] for word in named)
    for quantity, known in _OTHER_QUANTITIES.items():
        stating = {word for word in words if word in known and (role or word not in _LETTERS)}
        if role in VOLTAGE_ROLES:
            stating -= _COMMANDS | _ANGLE_LETTERS
        if names_side:
            stating -= _SIDES
        if role and _GROUP in stating and any(word in _WORDS[role] for word in words[words.index(_GROUP) :]):
            # As in ``/heli/state/pitch``: the part of a message.
            stating.remove(_GROUP)
        if stating:
            return quantity
    return A_COUNTER if not role and _COUNTERS.intersection(words) else ""


def direction_columns(units: Mapping[str, str]) -> dict[str, str]:
    """Return the columns with the directions of voltages, by the columns of the voltages."""
    meanings = {name: meaning_of(name, unit) for name, unit in units.items()}
    directions = {meaning.role: name for name, meaning in meanings.items() if meaning.quantity == A_DIRECTION}
    return {
        name: directions[meaning.role]
        for name, meaning in meanings.items()
        if meaning.role in VOLTAGE_ROLES and not meaning.quantity and meaning.role in directions
    }


def states_voltage(name: str, unit: str) -> bool:
    """Whether a `name` or its `unit` states a voltage, and not only a motor, as in ``front``."""
    unit = unit or split_unit(name)[1]
    return unit in VOLTAGE_UNITS or unit in SHARES or bool(_VOLTAGES.intersection(words_of(name)))


def unknown_unit_of(name: str) -> str:
    """Return the unit that a `name` states in brackets, if it is unknown; a known word there is a remark."""
    text = unknown_unit(name)
    known = itertools.chain(*_WORDS.values(), *_OTHER_QUANTITIES.values(), _MEASURED, _VOLTAGES, _HALVES)
    return "" if {text.lower(), *words_of(text)}.intersection(known) else text


def is_half(name: str) -> bool:
    """Whether a `name` means half of the sum, or half of the difference, of two voltages."""
    return bool(_HALVES.intersection(words_of(name)))


def is_element(name: str) -> bool:
    """Whether a `name` is that of a column of a matrix, as in ``data[2]``; the first one may be the time."""
    match = _ELEMENT.search(name)
    return match is not None and match.group() not in ("[1]", "(1)")


def is_time(name: str) -> bool:
    """Whether a `name` means the time, also by its unit alone, as in ``ms``. A letter after another word, as
    in ``theta_t``, is an index.
    """
    words = words_of(name)
    # A column `min` may be a minimum.
    is_bare_unit = len(words) == 1 and len(words[0]) > 1 and unit_of(words[0]) in ("s", "ms", "us", "ns")
    # In T_motor and T_amb the letter is a temperature.
    is_letter = words[:1] == ["t"] and meaning_of(name) == _NO_MEANING and not _VOLTAGES.intersection(words)
    return bool(_TIMES.intersection(words) - {"t"}) or is_letter or is_bare_unit

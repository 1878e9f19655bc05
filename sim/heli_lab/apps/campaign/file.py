"""Read the TOML file of a campaign: its work, and lists of settings, of which each combination is a case."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from heli_host.data.files import TOML_BYTES, decode_text, parse_toml, read_file

from heli_lab.apps.campaign.cases import Campaign, Case, Limits
from heli_lab.apps.campaign.works import DEFAULT_RANKING, DEFAULTS, TOLERANCES, WORKS, check_distribution
from heli_lab.errors import CampaignError

MAX_CASES: Final = 200_000
"""Largest number of cases: a store has one file per case, and a typing error may give millions of cases."""
_OWN_WORK: Final = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)*:[A-Za-z_]\w*")
_TOP: Final = ("title", "work", "cases", "draw", "limits", "worst")
_LISTS: Final = ("effects", "effect_files")
"""Settings each of whose values is a list."""
_FILES: Final = ("rig", "plan", "validate", "params", "effect_files")
"""Settings whose values may be files in the folder of the campaign file."""


def load_campaign(path: Path) -> Campaign:
    """Read the file of a campaign at `path`."""
    try:
        table = parse_toml(decode_text(read_file(path, TOML_BYTES)))
    except OSError as error:
        raise CampaignError(f"{path}: {error.strerror}", "give a campaign's TOML file") from None
    except ValueError as error:
        raise CampaignError(f"{path} is not TOML: {error}", "correct that line") from None
    try:
        return _campaign_of_table(path, table)
    except CampaignError as error:
        raise CampaignError(f"{path}: {error.cause}", error.remedy) from None


def _campaign_of_table(path: Path, table: Mapping[str, Any]) -> Campaign:
    """Convert the `table` of the file at `path` to a campaign; a CampaignError names a wrong entry."""
    _refuse_unknown_names(table, _TOP, "the file")
    if "work" not in table:
        raise CampaignError("work is missing", f"write work = one of {', '.join(WORKS)}")
    work = table["work"]
    if not isinstance(work, str) or (work not in WORKS and not _OWN_WORK.fullmatch(work)):
        raise CampaignError(
            f"work = {work!r} is unknown",
            f"write work = one of {', '.join(WORKS)}, or your own function as package.module:function",
        )
    title = table.get("title", path.stem)
    worst = table.get("worst", DEFAULT_RANKING.get(work, ""))
    if not isinstance(title, str) or not isinstance(worst, str):
        raise CampaignError("title and worst must be texts", "put them in quotes")
    lists = table.get("cases", {})
    if not isinstance(lists, dict):
        raise CampaignError("cases is not a table", "write [cases], and a list for each setting")
    if work in WORKS:
        _refuse_unknown_names(lists, tuple(DEFAULTS), "[cases]")
    values = {name: _setting_values(name, given, path.parent) for name, given in lists.items()}
    count = math.prod(map(len, values.values()))
    if count > MAX_CASES:
        raise CampaignError(
            f"these lists make {count} cases, more than {MAX_CASES}", "shorten one of the lists"
        )
    fixed = dict(DEFAULTS) if work in WORKS else {}
    draw = _check_draw(table.get("draw", {}))
    if draw:
        fixed["draw"] = draw
    modules = str(path.parent.resolve()) if work not in WORKS else ""
    cases = _case_per_combination(WORKS.get(work, work), values, fixed)
    return Campaign(title, cases, _limits_of_table(table.get("limits", {})), worst, modules)


def _case_per_combination(
    work: str, values: Mapping[str, Sequence[Any]], fixed: Mapping[str, Any]
) -> tuple[Case, ...]:
    """Make one case per combination of settings."""
    varied = [name for name, choices in values.items() if len(choices) > 1]
    cases = []
    for combination in itertools.product(*values.values()):
        settings = dict(zip(values, combination, strict=True))
        words = [
            f"seed {settings[name]}" if name == "seed" else _setting_text(settings[name]) for name in varied
        ]
        cases.append(Case(" ".join(words) or "the case", work, {**fixed, **settings}))
    return tuple(cases)


def _refuse_unknown_names(table: Mapping[str, Any], names: Sequence[str], where: str) -> None:
    """Raise a CampaignError if a `table`, which messages call `where`, has other entries than `names`."""
    unknown = [name for name in table if name not in names]
    if unknown:
        raise CampaignError(
            f"{where} has the unknown name {', '.join(unknown)}", f"choose from {', '.join(names)}"
        )


def _setting_values(name: str, given: Any, folder: Path) -> list[Any]:
    """List the values of a setting, which are given as a list, as a single value, or as a range with both
    ends, ``{ from = 1, to = 50 }``.
    """
    if isinstance(given, dict):
        first, last = given.get("from"), given.get("to")
        if len(given) != 2 or type(first) is not int or type(last) is not int or last < first:
            raise CampaignError(f"[cases] {name} is not a range", f"write {name} = {{ from = 1, to = 50 }}")
        if last - first >= MAX_CASES:
            raise CampaignError(f"[cases] {name} has {last - first + 1} values", f"give at most {MAX_CASES}")
        return list(range(first, last + 1))
    values = given if isinstance(given, list) else [given]
    # A single list of texts is one value of such a setting.
    if name in _LISTS and not all(isinstance(value, list) for value in values):
        values = [values]
    if not values:
        raise CampaignError(f"[cases] {name} has no value", "give it at least one value")
    for value in values:
        _check_type(name, value)
    return [_with_absolute_paths(name, value, folder) for value in values]


def _check_type(name: str, value: Any) -> None:
    """Raise a CampaignError if a value of the setting `name` has a wrong type, or is too small."""
    if name not in DEFAULTS:
        return
    required = type(DEFAULTS[name])
    if required is list:
        is_valid = isinstance(value, list) and all(isinstance(text, str) for text in value)
    else:
        is_valid = type(value) is required
    if not is_valid:
        kind = {list: "a list of texts", int: "a whole number", str: "a text"}[required]
        raise CampaignError(f"[cases] {name} = {value!r} is invalid", f"each value is {kind}")
    if required is int and value < (0 if name == "seed" else 1):
        raise CampaignError(f"[cases] {name} = {value} is too small", "give a larger value")


def _with_absolute_paths(name: str, value: Any, folder: Path) -> Any:
    """Make the path of a file absolute, because each worker runs in another folder; other values stay."""
    if name not in _FILES:
        return value
    if isinstance(value, list):
        return [_with_absolute_paths(name, entry, folder) for entry in value]
    path = folder / value
    return str(path.resolve()) if value and path.is_file() else value


def _check_draw(given: Any) -> Any:
    """Check the entry ``draw`` of a file, ``tolerances`` or distributions by name, and return it."""
    if given in (TOLERANCES, {}):
        return given
    if not isinstance(given, dict):
        raise CampaignError(f"draw = {given!r} is invalid", f'write draw = "{TOLERANCES}", or a table')
    for name, distribution in given.items():
        check_distribution(name, distribution)
    return given


def _limits_of_table(given: Any) -> Limits:
    """Convert the table ``[limits]`` of a file; missing limits get their defaults."""
    if not isinstance(given, dict):
        raise CampaignError("limits is not a table", "write [limits]")
    _refuse_unknown_names(given, ("cpu_s", "wait_s"), "[limits]")
    for name, value in given.items():
        if not isinstance(value, int | float) or isinstance(value, bool) or not value > 0.0:
            raise CampaignError(f"[limits] {name} = {value!r} is invalid", "give seconds above 0")
    cpu_s = float(given.get("cpu_s", Limits.cpu_s))
    return Limits(cpu_s, float(given.get("wait_s", 10.0 * cpu_s)))


def _setting_text(value: Any) -> str:
    """Format a setting for the name of a case."""
    if isinstance(value, list):
        return "+".join(map(str, value)) or "nothing"
    return Path(value).stem if isinstance(value, str) and Path(value).is_absolute() else str(value)

"""The error tree of heli_host: as printed, and every message one line."""

from __future__ import annotations

import inspect
import re

from heli_host import errors
from heli_host.declaration import FAULTS, PARAMS, Param


def printed_tree() -> dict[str, str]:
    """Parent of every class in the tree at the top of the file, by its depth of indentation."""
    parents: dict[str, str] = {}
    path = ["Exception"]
    for line in (errors.__doc__ or "").splitlines():
        entry = re.match(r"^    ([│ ├└─]*)([A-Z]\w+) ", line)
        if entry:
            depth = len(entry[1]) // 4
            del path[depth + 1 :]
            parents[entry[2]] = path[-1]
            path.append(entry[2])
    return parents


def test_the_printed_tree_is_the_tree() -> None:
    classes = {
        name: thing.__mro__[1].__name__
        for name, thing in vars(errors).items()
        if inspect.isclass(thing) and issubclass(thing, Exception)
    }
    assert printed_tree() == classes


def test_a_message_is_one_line_whatever_goes_into_it() -> None:
    assert str(errors.PlanError("two\nlines ", " of\n\ttext")) == "two lines; of text"
    assert str(errors.PlanError("cause alone")) == "cause alone"


def test_every_fault_says_its_name_its_limit_and_its_remedy() -> None:
    for spec in FAULTS:
        text = errors.fault_text(spec.code)
        assert text.startswith(f"{spec.name}: ")
        assert text.endswith(spec.remedy)
        assert spec.parameter is None or spec.parameter in text
    assert errors.fault_text(0) == "no fault"
    assert "unknown to this host" in errors.fault_text(250)


def test_every_parameter_says_its_range_in_words() -> None:
    for spec in PARAMS:
        text = errors.range_text(Param(spec.index))
        if spec.name.endswith("_sign"):
            assert text == "-1 or 1"
            continue
        assert f"{spec.min:g} to {spec.max:g}" in text
        assert ("whole" in text) == spec.integer
        assert ("not 0" in text) == spec.nonzero

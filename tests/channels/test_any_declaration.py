"""Nothing on the host depends on the order, the number or the types of the channels that are declared."""

from __future__ import annotations

import itertools
import random
from pathlib import Path

import numpy as np
import pytest
from heli_host.data.log.reader import read_flight
from heli_host.declaration import CHANNELS

from tests.channels import through_the_host
from tests.channels.changed_copy import DECLARATION, ChangedCopy, channel

pytestmark = pytest.mark.slow

PROGRAM = Path(through_the_host.__file__)
MARK = "[[channel]]\n"
NAMES = [spec.name for spec in CHANNELS]


def rearranged(text: str, order: list[str]) -> str:
    """A declaration with its channels in another order."""
    head, *entries = text.split(MARK)
    last, mark, tail = entries[-1].partition("\n# ----")
    entries[-1] = last + "\n"
    by_name = dict(zip(NAMES, entries, strict=True))
    return head + "".join(MARK + by_name[name] for name in order) + mark.lstrip("\n") + tail


def came_through(copy: ChangedCopy, folder: Path) -> list[str]:
    """Check the copy's host; its channels, in order."""
    copy.generate()
    return copy.run(str(PROGRAM), str(folder)).strip().split(",")


def test_the_declared_channels_come_through(tmp_path: Path) -> None:
    through_the_host.check(tmp_path)


@pytest.mark.parametrize(
    "order",
    [NAMES[::-1], random.Random(1).sample(NAMES, len(NAMES)), NAMES[-3:] + NAMES[:-3]],
    ids=["backwards", "shuffled", "unsigned first"],
)
def test_channels_may_stand_in_any_order(tmp_path: Path, order: list[str]) -> None:
    copy = ChangedCopy(tmp_path / "copy")
    path = copy.root / DECLARATION
    path.write_text(rearranged(path.read_text(encoding="utf-8"), order), encoding="utf-8")
    assert came_through(copy, tmp_path) == order


def test_channels_of_every_type_may_stand_anywhere(tmp_path: Path) -> None:
    copy = ChangedCopy(tmp_path / "copy")
    added = itertools.product(("u32", "u16", "u8", "i16", "i32"), ((1.0, ""), (0.0625, "rad/s2")))
    places = ["elevation_count", "elevation_count", "front", "state", "flags", *[""] * 5]
    for number, ((wire_type, (scale, unit)), before) in enumerate(zip(added, places, strict=True)):
        copy.add_channel(channel(f"more_{number}", wire_type, unit, scale), before)
    names = came_through(copy, tmp_path)
    assert names[:2] == ["more_0", "more_1"] and names[-1] == "more_9"
    assert len(names) == len(NAMES) + 10


def test_a_second_channel_of_an_enumeration_shares_its_names(tmp_path: Path) -> None:
    copy = ChangedCopy(tmp_path / "copy")
    copy.add_channel(channel("state_before", "u8", "enum state"), before="state")
    copy.add_channel(channel("reset_cause", "u8", "enum reset"))
    assert "state_before" in came_through(copy, tmp_path)


def test_a_log_by_a_version_with_a_finer_scale_is_not_rounded_to_ours(tmp_path: Path) -> None:
    copy = ChangedCopy(tmp_path / "copy")
    back = 'name = "back"\ntype = "i16"\nunit = "V"\nscale = '
    copy.replace(DECLARATION, f"{back}0.001", f"{back}0.00001")
    came_through(copy, tmp_path)
    logged, table = (read_flight(tmp_path / name) for name in ("a.mcap", "a.csv"))
    assert np.abs(table.back_V).max() < 0.13
    np.testing.assert_allclose(logged.back_V, table.back_V, rtol=1e-6, atol=1e-9)

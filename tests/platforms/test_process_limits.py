"""A process keeps the limits that its system knows, where the system lacks others."""

from __future__ import annotations

import pytest
from heli_host.data.files import limit_process

resource = pytest.importorskip("resource")


@pytest.fixture
def limits(monkeypatch: pytest.MonkeyPatch) -> dict[int, tuple[int, int]]:
    """Limits of a process on a system without one of the address space, such as macOS."""
    present = {
        resource.RLIMIT_CPU: (60, 60),
        resource.RLIMIT_FSIZE: (resource.RLIM_INFINITY, resource.RLIM_INFINITY),
    }

    def set_limit(number: int, limit: tuple[int, int]) -> None:
        if number == resource.RLIMIT_AS or present[number][1] not in (
            resource.RLIM_INFINITY,
            *range(limit[1], 61),
        ):
            raise ValueError("current limit exceeds maximum limit")
        present[number] = limit

    monkeypatch.setattr(resource, "setrlimit", set_limit)
    monkeypatch.setattr(resource, "getrlimit", lambda number: present.get(number, (-1, -1)))
    return present


def test_limit_that_the_system_lacks_does_not_stop_the_others(limits: dict[int, tuple[int, int]]) -> None:
    limit_process("AS", 1 << 30, 1 << 30)
    limit_process("FSIZE", 0, 0)
    assert limits[resource.RLIMIT_FSIZE] == (0, 0)
    assert resource.RLIMIT_AS not in limits


def test_stricter_limit_of_the_parent_stays(limits: dict[int, tuple[int, int]]) -> None:
    limit_process("CPU", 100, 105)
    assert limits[resource.RLIMIT_CPU] == (60, 60)


def test_soft_limit_can_be_raised_again_up_to_the_hard_one(limits: dict[int, tuple[int, int]]) -> None:
    limit_process("CPU", 10)
    limit_process("CPU", 20)
    assert limits[resource.RLIMIT_CPU] == (20, 60)

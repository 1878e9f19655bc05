"""There is one pilot: the first, until they hand over, or are gone and another page asks."""

from __future__ import annotations

from heli_host.ui.page.clients import ABSENT_S, PRESENT_S, ControlLease


def lease_of_two_clients() -> ControlLease:
    lease = ControlLease()
    assert lease.join("a", "page 1", 0.0)
    assert lease.join("b", "page 2", 0.0)
    return lease


def test_the_first_flies_and_a_program_never_by_itself() -> None:
    lease = ControlLease()
    lease.join("p", "program 1", 0.0, may_fly=False)
    assert lease.pilot is None
    lease.join("a", "page 2", 0.0)
    assert lease.pilot == "a"


def test_who_does_not_fly_neither_hands_over_nor_keeps() -> None:
    lease = lease_of_two_clients()
    assert not lease.ask("b", 0.0)
    assert not lease.answer("b", grant=True)
    assert lease.pilot == "a"
    assert lease.answer("a", grant=True)
    assert lease.pilot == "b"
    assert lease.asking is None


def test_a_pilot_is_present_as_long_as_the_last_sign_of_life_is_fresh() -> None:
    lease = lease_of_two_clients()
    lease.beat("a", 10.0)
    lease.beat("b", 20.0)
    assert lease.present(10.0 + PRESENT_S)
    assert not lease.present(10.0 + PRESENT_S + 0.01)


def test_a_pilot_who_left_is_absent_at_once_and_has_control_when_back() -> None:
    lease = lease_of_two_clients()
    lease.beat("a", 1.0)
    lease.leave("a")
    assert not lease.present(1.0)
    assert lease.pilot == "a"
    assert lease.join("a", "page 3", 1.1)
    assert lease.present(1.1)


def test_control_of_an_absent_pilot_can_be_taken_and_the_pilot_watches() -> None:
    lease = lease_of_two_clients()
    lease.beat("a", 1.0)
    assert not lease.ask("b", 1.0 + ABSENT_S)
    assert lease.ask("b", 1.0 + ABSENT_S + 0.01)
    assert lease.pilot == "b"
    lease.beat("a", 5.0)
    assert lease.pilot == "b"


def test_who_asked_and_left_asks_no_more() -> None:
    lease = lease_of_two_clients()
    lease.ask("b", 0.1)
    lease.leave("b")
    assert lease.asking is None
    assert not lease.answer("a", grant=True)
    assert lease.pilot == "a"


def test_an_id_that_is_connected_is_not_given_twice() -> None:
    lease = lease_of_two_clients()
    assert not lease.join("a", "page 3", 0.0)
    assert lease.count() == 2

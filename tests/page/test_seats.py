"""One pilot: the first, until he hands over or is gone and somebody asks."""

from __future__ import annotations

from heli_host.page.seats import ABSENT_S, PRESENT_S, Seats


def two() -> Seats:
    seats = Seats()
    assert seats.join("a", "page 1", 0.0)
    assert seats.join("b", "page 2", 0.0)
    return seats


def test_the_first_flies_and_a_program_never_by_itself() -> None:
    seats = Seats()
    seats.join("p", "program 1", 0.0, may_fly=False)
    assert seats.pilot is None
    seats.join("a", "page 2", 0.0)
    assert seats.pilot == "a"


def test_who_does_not_fly_neither_hands_over_nor_keeps() -> None:
    seats = two()
    assert not seats.ask("b", 0.0)
    assert not seats.answer("b", grant=True)
    assert seats.pilot == "a"
    assert seats.answer("a", grant=True)
    assert seats.pilot == "b"
    assert seats.asking is None


def test_a_pilot_is_present_as_long_as_his_last_sign_is_fresh() -> None:
    seats = two()
    seats.beat("a", 10.0)
    seats.beat("b", 20.0)
    assert seats.present(10.0 + PRESENT_S)
    assert not seats.present(10.0 + PRESENT_S + 0.01)


def test_a_pilot_who_left_is_absent_at_once_and_has_his_seat_when_he_is_back() -> None:
    seats = two()
    seats.beat("a", 1.0)
    seats.leave("a")
    assert not seats.present(1.0)
    assert seats.pilot == "a"
    assert seats.join("a", "page 3", 1.1)
    assert seats.present(1.1)


def test_control_of_an_absent_pilot_is_had_by_asking_and_he_watches_when_he_is_back() -> None:
    seats = two()
    seats.beat("a", 1.0)
    assert not seats.ask("b", 1.0 + ABSENT_S)
    assert seats.ask("b", 1.0 + ABSENT_S + 0.01)
    assert seats.pilot == "b"
    seats.beat("a", 5.0)
    assert seats.pilot == "b"


def test_who_asked_and_left_asks_no_more() -> None:
    seats = two()
    seats.ask("b", 0.1)
    seats.leave("b")
    assert seats.asking is None
    assert not seats.answer("a", grant=True)
    assert seats.pilot == "a"


def test_an_id_that_is_connected_is_not_given_twice() -> None:
    seats = two()
    assert not seats.join("a", "page 3", 0.0)
    assert seats.count() == 2

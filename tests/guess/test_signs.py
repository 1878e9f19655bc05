"""Wrong signs and zeros are named before anything is fitted, and nothing else is."""

import math
from dataclasses import replace

import numpy as np
import pytest
from heli_host.data.flight import Flight
from heli_lab.setup.guess.motion import Reference
from heli_lab.setup.guess.signs import _zeroed_at_rest, wrong_signs
from heli_lab.setup.guess.units import RestElevation

from tests.guess.flights import measured, measured_flight, simulated
from tests.running.long import samples


def descriptions(flight: Flight, number: int = 1) -> list[str]:
    return [item.description for item in wrong_signs(flight, simulated(number)[1])]


@pytest.mark.slow
@pytest.mark.parametrize("number", [0, 2])
def test_nothing_is_said_of_a_sound_flight(number: int) -> None:
    assert descriptions(simulated(number)[0], number) == []


@pytest.mark.slow
def test_each_wrong_sign_is_named() -> None:
    flight = simulated(1)[0]
    swapped = replace(flight, front_V=flight.back_V, back_V=flight.front_V)
    for wrong, words in (
        (replace(flight, travel_rad=-flight.travel_rad), "travel goes against pitch"),
        (replace(flight, pitch_rad=-flight.pitch_rad), "pitch has the opposite sign"),
        (swapped, "the motors are exchanged"),
        (replace(flight, elevation_rad=-flight.elevation_rad), "elevation falls when the voltages rise"),
    ):
        (item,) = descriptions(wrong)
        assert words in item


@pytest.mark.slow
def test_a_zero_at_rest_and_degrees_are_named() -> None:
    flight = simulated(1)[0]
    (item,) = descriptions(replace(flight, elevation_rad=flight.elevation_rad - flight.elevation_rad[0]))
    assert "zeroed there" in item
    degrees = {
        name: np.degrees(getattr(flight, name)) for name in ("elevation_rad", "pitch_rad", "travel_rad")
    }
    (item,) = descriptions(replace(flight, **degrees))
    assert "in degrees" in item


@pytest.mark.slow
def test_measured_flights_are_sound_and_their_wrong_copies_are_not() -> None:
    if not measured():
        pytest.skip("skipped: no shared data")
    for path in measured()[:: samples(1, 6)]:
        flight, rig = measured_flight(path)
        assert wrong_signs(flight, rig) == (), path.name
        (item,) = wrong_signs(replace(flight, travel_rad=-flight.travel_rad), rig)
        assert item.inverted_axes == ("travel",), path.name
        at_rest = replace(flight, elevation_rad=flight.elevation_rad - math.radians(-30.0))
        assert any("zeroed there" in item.description for item in wrong_signs(at_rest, rig)), path.name


@pytest.mark.parametrize(
    ("table_deg", "is_reported"), [(-25.0, True), (-11.0, True), (-9.0, False), (9.0, False)]
)
def test_a_rest_at_0_is_no_wrong_zero_on_a_rig_that_rests_near_level(
    table_deg: float, is_reported: bool
) -> None:
    # Its tolerance of 1 deg and the 4 deg of the check reach 5 deg to both sides.
    reference = Reference({}, {}, 6.0, table_deg, 1.0, {}, 12.0)
    rest = RestElevation(deg=0.5, median_deg=20.0, begins_lowest=True)
    assert (_zeroed_at_rest(rest, reference) is not None) == is_reported
    assert _zeroed_at_rest(replace(rest, begins_lowest=False), reference) is None
    assert _zeroed_at_rest(replace(rest, deg=None), reference) is None
    assert _zeroed_at_rest(replace(rest, deg=-5.5), reference) is None

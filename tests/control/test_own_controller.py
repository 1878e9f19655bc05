"""Your own compiled controller: the steps of firmware/examples/README.md, done to a copy, built and flown."""

import json
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any, Final

import pytest

from tests.channels import changed_copy
from tests.channels.changed_copy import ROOT, ChangedCopy
from tests.firmware.built import take_over_objects
from tests.running.kept import KEPT

pytestmark = pytest.mark.slow

EXAMPLES: Final = ROOT / "firmware" / "examples"
FLIGHT_CODE: Final = "firmware/core/flight_code.hpp"
README: Final = (EXAMPLES / "README.md").read_text(encoding="utf-8")
FLIGHT: Final = Path(__file__).with_name("fly_own_controller.py")
NAMED_BY_STEPS: Final = re.findall(r"^   - `(.+)`$", README, re.MULTILINE)
DIFFS: Final = re.findall(r"^```diff\n(.*?)^```$", README, re.MULTILINE | re.DOTALL)


def followed(root: Path) -> ChangedCopy:
    """The sources with the steps done: the files in place, the lines in the file that names controllers."""
    # Lines that are there already stay, and a reader's own controllers may be between the lines of the steps.
    copy = ChangedCopy(root)
    for name in NAMED_BY_STEPS:
        shutil.copy(EXAMPLES / Path(name).name, copy.root / name)
    for diff in DIFFS:
        before = "".join(line[1:] for line in diff.partition("+")[0].splitlines(True))
        (added,) = (line[1:] for line in diff.splitlines(True) if line[0] == "+")
        if added not in (copy.root / FLIGHT_CODE).read_text(encoding="utf-8"):
            copy.replace(FLIGHT_CODE, before, before + added)
    return copy


@pytest.fixture(scope="module")
def flown(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Output of the flight of the copy."""
    copy = followed(tmp_path_factory.mktemp("own controller") / "copy")

    def compiled() -> bytes:
        copy.build()
        return copy.extension.read_bytes()

    made_by = (Path(__file__), Path(changed_copy.__file__), ROOT / "CMakeLists.txt", EXAMPLES / "README.md")
    copy.extension.write_bytes(
        KEPT("board with an LQR", compiled, made_by=made_by, rooms=("firmware", "sim/native"))
    )
    report: dict[str, Any] = json.loads(copy.run(str(FLIGHT)))
    return report


def test_the_steps_name_two_files_and_one_that_changes() -> None:
    assert NAMED_BY_STEPS == ["firmware/core/control/lqr.hpp", "firmware/core/control/lqr.cpp"]
    assert sorted(path.name for path in EXAMPLES.iterdir()) == ["README.md", "lqr.cpp", "lqr.hpp"]
    assert sum(line.startswith("+") for diff in DIFFS for line in diff.splitlines()) == 3


def test_the_board_names_the_new_controller_after_its_own(flown: dict[str, Any]) -> None:
    assert flown["names"][:2] == ["cascade", "lqr"]
    assert flown["logged"] == "lqr"


def test_the_sample_lqr_flies_to_its_setpoint_and_lands(flown: dict[str, Any]) -> None:
    assert flown["elevation_deg"] == pytest.approx(5.0, abs=1.0)
    assert flown["travel_deg"] == pytest.approx(20.0, abs=3.0)
    assert flown["end"] == "idle"


def test_the_voltages_are_those_of_the_state_feedback(flown: dict[str, Any]) -> None:
    # A cascade would ask for another difference: it also has integrators.
    assert flown["differential_error_V"] < 0.02
    assert flown["differential_range_V"] > 0.5


def test_a_switch_in_flight_is_refused_and_the_flight_goes_on(flown: dict[str, Any]) -> None:
    assert flown["switch"] == "UNSAFE_NOW"


def test_it_takes_over_from_an_uploaded_law_without_a_jump(flown: dict[str, Any]) -> None:
    assert flown["law_flew"]
    assert flown["takeover_jump_V"] < 0.1


def test_it_tilts_the_arm_when_the_board_checks_the_travel_encoder(flown: dict[str, Any]) -> None:
    assert flown["without_travel"] == "TRAVEL_MOTIONLESS"


@pytest.mark.emulated
def test_the_due_builds_it_within_its_bounds_and_divides_nowhere_in_a_tick(tmp_path: Path) -> None:
    copy = followed(tmp_path / "copy")
    take_over_objects(tmp_path / "build", copy.root / "firmware")
    command = ["make", "-C", f"{copy.root}/firmware/due", f"BUILD={tmp_path}/build"]
    process = subprocess.run(command, capture_output=True, text=True, check=False)
    assert process.returncode == 0, process.stdout + process.stderr
    compiled = re.findall(r"-c \S+/firmware/(\S+)", process.stdout)
    assert sorted(compiled) == ["core/control/lqr.cpp", "due/main.cpp"]

"""No verb replaces a file that the program did not write, and an interrupted one leaves the old file."""

import errno
import gzip
import json
import re
from pathlib import Path
from typing import Any

import pytest
from heli_host.data.files import (
    FORCE,
    ForeignFile,
    check_replaceable,
    is_own_file,
    replacing,
    write_signed,
    write_text,
)
from heli_host.ui.cli.entry import command_line, run

from tests.cli.terminal import listed_commands

LAW = "# My own law; three evenings of work.\nimport heli_host  # written by me\n"

OUTPUTS = {
    "fly": "fly hover --sil {option}",
    "record": "record --sil --duration 1 {option}",
    "setpoint": "setpoint --sil --take-off --duration 1 {option}",
    "calibrate": "calibrate --sil {option}",
    "doctor": "doctor {option}",
    "ports": "ports {option}",
    "export": "export {log} --csv {option}",
    "import": "import {table} --guess -o {folder} {option}",
    "info": "info {log} {option}",
    "plot": "plot {log} {option}",
    "campaign": "campaign {table} {option}",
    "class": "class {folder} {option}",
    "course": "course {notebook} {option}",
    "diagnose": "diagnose {log} {option}",
    "identify": "identify {log} {option}",
    "pool": "pool {table} {option}",
    "tune": "tune makki2024 {option}",
    "web": "web {option}",
    "twin": "twin {log} {option}",
    "predict": "predict {log} {option}",
    "params list": "params list --sil {option}",
    "params get": "params get hover_V --sil {option}",
    "params set": "params set hover_V 2 --sil {option}",
    "params restore": "params restore {table} --sil {option}",
    "rig list": "rig list {option}",
    "rig show": "rig show makki2024 {option}",
    "rig check": "rig check makki2024 {option}",
    "rig diff": "rig diff makki2024 makki2024 {option}",
    "rig weigh": "rig weigh {table} {option}",
    "rig export": "rig export makki2024 --format mjcf {option}",
    "benchmark score": "benchmark score {folder} {folder} {option}",
    "benchmark run": "benchmark run {folder} {option}",
    "benchmark report": "benchmark report {folder} {option}",
    "law check": "law check {law} {option}",
    "law fly": "law fly {law} --sil {option}",
    "law compare": "law compare {law} --sil {option}",
    "law grade": "law grade {law} {option}",
    "law export": "law export {law} {option}",
    "paper tables": "paper tables {option}",
    "paper gains": "paper gains {option}",
    "paper models": "paper models {option}",
    "params dump": "params dump {file} --sil",
    "rig new": "rig new {file} --set M_w=1.87",
    "rig from-board": "rig from-board {table} {file}",
    "rig to-board": "rig to-board makki2024 {file} --params {table}",
}
"""A command line for each verb that writes; {option} is the output option, {file} an output without one."""
FILE_IN_FOLDER = {"course --output": "student/notebook.ipynb"}
"""A file that the verb writes into the folder that an option names."""
FOLDERS_AFTER_WORK = {
    "campaign --output",
    "benchmark run --output",
    "import --output",
    "benchmark report --output",
}
"""Options whose folder gets files under names that only the work decides; see
`test_nothing_writes_a_result_past_the_rule`."""


def writes(parameter: Any) -> bool:
    """Whether an option or argument names a place for a result, by its help alone."""
    text = str(getattr(parameter, "help", "") or "")
    begins = ("Write", "Draw", "Record the flight", "Save the search", "Set the alarm threshold")
    kinds = ("FILE", "DIR", "FOLDER", "RUN")
    is_place = any(kind in str(parameter.metavar or parameter.name) for kind in kinds)
    return text.startswith(begins) and (is_place or "this TOML file" in text)


def places() -> list[tuple[str, str]]:
    """Each verb with each of its outputs: an option, or empty for an argument."""
    return [
        (name, max(parameter.opts, key=len) if parameter.opts[0].startswith("-") else "")
        for name, command in listed_commands(command_line())
        for parameter in command.params
        if writes(parameter)
    ]


PLACES = places()


def test_the_table_has_every_verb_that_writes() -> None:
    assert len(PLACES) > 60
    assert {name for name, _ in PLACES} - set(OUTPUTS) == {"flash", "paper figures", "benchmark make"}


@pytest.mark.parametrize(
    ("verb", "option"),
    [place for place in PLACES if place[0] in OUTPUTS and f"{place[0]} {place[1]}" not in FOLDERS_AFTER_WORK],
)
def test_a_file_of_somebody_else_stays_as_it_is(
    verb: str,
    option: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    ending = {"--figure": ".png", "--log": ".mcap"}.get(option, ".py")
    folder = tmp_path / "out"
    if option == "--report":
        target, given = folder / "index.html", folder
    elif f"{verb} {option}" in FILE_IN_FOLDER:
        target, given = folder / FILE_IN_FOLDER[f"{verb} {option}"], folder
    else:
        target = given = tmp_path / f"mine{ending}"
    target.parent.mkdir(parents=True, exist_ok=True)
    target.write_text(LAW)
    (tmp_path / "table.toml").write_text("[parameters]\nhover_V = 2.0\n")
    (tmp_path / "notebook.py").write_text("# %% [markdown]\n# Words\n")
    line = OUTPUTS[verb].format(
        option=f"{option} {given}" if option else "",
        file=given,
        log=tmp_path / "log.mcap",
        table=tmp_path / "table.toml",
        folder=tmp_path / "folder",
        notebook=tmp_path / "notebook.py",
        law=tmp_path / "law.py",
    )
    assert run(line.split()) in (2, 5)
    assert target.read_text() == LAW
    errors = [text for text in capsys.readouterr().err.splitlines() if text.startswith("error: ")]
    assert len(errors) == 1
    assert str(target) in errors[0]
    assert "did not write it" in errors[0] or "exists already" in errors[0]


def test_what_the_program_wrote_is_replaced_and_with_force_everything(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = tmp_path / "mine.json"
    assert run(["rig", "show", "makki2024", "--json", str(result)]) == 0
    assert run(["rig", "show", "kristian2022", "--json", str(result)]) in (0, 2)
    assert run(["rig", "show", "makki2024", "--json", str(result)]) == 0
    result.write_text(LAW)
    assert run(["rig", "show", "makki2024", "--json", str(result)]) == 5
    assert result.read_text() == LAW
    for words in (["--force", "rig", "show"], ["rig", "show", "--force"]):
        result.write_text(LAW)
        assert run([*words, "makki2024", "--json", str(result)]) == 0
        assert json.loads(result.read_text())["schema"] == 1
    assert not FORCE.get()
    capsys.readouterr()


def test_an_edited_file_is_not_replaced(tmp_path: Path) -> None:
    file = tmp_path / "rig.toml"
    write_signed(file, 'name = "mine"\n')
    assert is_own_file(file)
    write_signed(file, 'name = "again"\n')
    for edited in (
        file.read_text().replace("again", "weighed"),
        "# my note\n" + file.read_text(),
        file.read_text() + "# my note\n",
        file.read_text().replace("\n", "\r\n"),
    ):
        file.write_text(edited, newline="")
        assert not is_own_file(file)
        with pytest.raises(ForeignFile, match="or it was edited since"):
            write_signed(file, "other")
        assert file.read_bytes() == edited.encode()
        write_signed_by_force(file)


def write_signed_by_force(file: Path) -> None:
    token = FORCE.set(True)
    try:
        write_signed(file, 'name = "again"\n')
    finally:
        FORCE.reset(token)
    assert is_own_file(file)


def test_files_of_other_programs_are_not_taken_for_ours(tmp_path: Path) -> None:
    import matplotlib.figure

    figure = tmp_path / "figure.png"
    matplotlib.figure.Figure().savefig(figure)
    assert not is_own_file(figure)
    for name, content in {
        "a.json": b'{"name": 1}',
        "a.csv": b"t_s,angle\n0,1\n",
        "a.csv.gz": gzip.compress(b"t_s,angle\n0,1\n"),
        "b.csv.gz": b"\x1f\x8bbroken",
        "a.mcap": b"\x89MCAP0\r\nother",
        "a.mat": b"MATLAB 5.0 MAT-file, Platform: GLNXA64",
        "a.ipynb": b'{"cells": [], "metadata": {}}',
        "a.toml": b"# Written by heli-host rig new\n",
        "a.py": b"# written by heli-host, digest 0123456789abcdef\n",
    }.items():
        (tmp_path / name).write_bytes(content)
        assert not is_own_file(tmp_path / name), name


def test_a_page_with_a_picture_in_one_long_line_is_recognised_at_once(tmp_path: Path) -> None:
    # A search from each character of such a line, instead of its last line alone, takes many minutes.
    page = tmp_path / "index.html"
    write_signed(page, f"<img src='{'A' * 4_000_000}'>\n")
    assert is_own_file(page)
    page.write_bytes(page.read_bytes().replace(b"AB", b"AA").replace(b"src='A", b"src='B"))
    assert not is_own_file(page)


def test_a_full_disk_leaves_the_old_file_and_no_rest(tmp_path: Path) -> None:
    file = tmp_path / "result.json"
    write_text(file, '{"schema": 1, "a": 1}')
    before = file.read_bytes()

    def fail() -> None:
        with replacing(file) as unfinished, unfinished.open("wb") as opened:
            opened.write(b"half")
            raise OSError(errno.ENOSPC, "No space left on device")

    with pytest.raises(OSError, match="No space left"):
        fail()
    assert file.read_bytes() == before
    assert [path.name for path in tmp_path.iterdir()] == ["result.json"]
    with pytest.raises(KeyboardInterrupt), replacing(file):
        raise KeyboardInterrupt
    assert [path.name for path in tmp_path.iterdir()] == ["result.json"]


def test_a_link_stays_a_link_and_a_mode_stays(tmp_path: Path) -> None:
    file, link = tmp_path / "real.json", tmp_path / "link.json"
    write_text(file, '{"schema": 1, "a": 1}')
    file.chmod(0o640)
    link.symlink_to(file)
    write_text(link, '{"schema": 1, "a": 2}')
    assert link.is_symlink()
    assert json.loads(file.read_text())["a"] == 2
    assert file.stat().st_mode & 0o777 == 0o640


def test_a_folder_and_a_missing_file_are_no_foreign_files(tmp_path: Path) -> None:
    check_replaceable(tmp_path)
    check_replaceable(tmp_path / "none")
    (tmp_path / "empty").touch()
    check_replaceable(tmp_path / "empty")


@pytest.mark.slow
def test_every_writer_of_the_program_leaves_a_file_that_it_recognises(tmp_path: Path) -> None:
    from heli_host.data.log.reader import read_flight
    from heli_host.data.log.ros2 import export_ros2
    from heli_host.data.log.table import export_mat, export_parquet, notes_path, write_csv

    log = tmp_path / "flight.mcap"
    assert run(["record", "--sil", "--speed", "max", "--duration", "1", "-o", str(log), "--quiet"]) == 0
    flight = read_flight(log)
    for write, name in (
        (write_csv, "a.csv"),
        (write_csv, "a.csv.gz"),
        (export_mat, "a.mat"),
        (export_parquet, "a.parquet"),
        (export_ros2, "a.ros2.mcap"),
    ):
        for _ in range(2):
            write(flight, tmp_path / name)
        assert is_own_file(tmp_path / name), name
    assert is_own_file(log)
    assert is_own_file(notes_path(tmp_path / "a.csv"))
    for ending in (".png", ".pdf", ".svg"):
        for _ in range(2):
            assert run(["plot", str(log), "--figure", str(tmp_path / f"a{ending}")]) == 0
        assert is_own_file(tmp_path / f"a{ending}"), ending


DIRECT = re.compile(
    r"\.write_text\(|\.write_bytes\(|\.savefig\(|open\([^()]*[\"'][wax]b?[\"']|pq\.write_table\("
)
STATE = {
    "host/heli_host/data/files.py": "the rule itself",
    "host/heli_host/data/flight.py": "a picture in memory",
    "host/heli_host/data/log/blind.py": "within replacing",
    "host/heli_host/data/log/ros2.py": "within replacing",
    "host/heli_host/data/log/table.py": "within replacing",
    "host/heli_host/ui/cli/flight.py": "a temporary folder",
    "sim/heli_sim/evaluate/compiled.py": "the cache",
    "sim/heli_sim/checks.py": "a probe of the cache",
    "sim/heli_sim/fmu/write.py": "a temporary folder",
    "sim/heli_sim/model/effects/table.py": "a document of this repository",
    "sim/heli_sim/sil/boards.py": "the flash of a simulated board",
    "sim/heli_lab/report/page/drawing.py": "a picture in memory",
    "sim/heli_lab/apps/campaign/store.py": "the state of a campaign, in a folder with its token",
    "sim/heli_lab/apps/classroom/marking.py": "a temporary folder",
    "sim/heli_lab/explain/comparison.py": "the file of --resume, which checks its first line",
}
"""Files of the packages that write without the rule, and why that loses nothing of a user."""


def test_nothing_writes_a_result_past_the_rule() -> None:
    root = Path(__file__).resolve().parents[2]
    writers = {
        str(path.relative_to(root))
        for package in ("host/heli_host", "sim/heli_sim", "sim/heli_lab")
        for path in (root / package).rglob("*.py")
        if DIRECT.search(path.read_text())
    }
    assert writers == set(STATE)

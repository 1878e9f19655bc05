"""Read the submissions of a class: a folder per student with a control law, a plan or parameters."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from heli_host.board.law_program import LawProgram
from heli_host.board.parameters import TABLE, parameter_set
from heli_host.data.files import (
    FORCE,
    TOML_BYTES,
    ForeignFile,
    decode_text,
    is_own_file,
    parse_toml,
    read_file,
)
from heli_host.declaration import PARAMS
from heli_host.errors import BadLaw, HeliError, ParameterError, PlanError, file_remedy
from heli_host.fly.plan import Plan

from heli_lab.control.fence import FileLimits
from heli_lab.control.law_files import load_limited

MARKED: Final = "marked"
"""Folder in a submission for the files that are returned to the student: log, figure and mark."""
LAW_FILE: Final = "law.py"
RIG_LOG: Final = "rig.mcap"
_RIG_FILES: Final = re.compile(r"rig(-\d+)?\.(mcap|png)")
"""Files of flights on the rig in `MARKED`; they are kept when a submission is marked again."""
_MARKED_FILES: Final = re.compile(r"mark\.json|flight\.mcap|figure\.png|rig(-\d+)?\.(mcap|png)")
LONGEST_PLAN_s: Final = 120.0
"""Longest plan of a submission [s]. The built-in plans take up to 80 s; thirty plans of an hour would occupy
the rig for a day."""
_MAX_FILES: Final = 200
"""Largest number of files in a submission."""
_GAINS: Final = re.compile(
    r"hover_(V|slope)|\w+_(kp|ki|kd|ff)|\w+_integral_max_(V|deg)|(elevation|pitch|travel)_filter_Hz"
    r"|pitch_setpoint_max_deg|differential_max_V|bumpless_s"
)
"""Parameters that a submission may change. The others describe the rig, protect it, or shape the
setpoints with which a flight is compared."""


@dataclass(frozen=True)
class Submission:
    """Work of one student, read and checked."""

    name: str  # Name of the folder
    program: LawProgram | None = None  # The student's control law; None for the board's own
    plan: Plan | None = None  # The student's plan; None for the plan of the class
    gains: Mapping[str, float] = field(default_factory=dict)
    """Gains of the board's own law from the student's parameter file, by name."""


def submissions_in(folder: Path) -> list[Path]:
    """Return the folders of the submissions, by name; hidden folders are left out."""
    if not folder.is_dir():
        raise BadLaw(f"{folder} is not a folder", "give the folder that has one folder per submission")
    folders = sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))
    if not folders:
        raise BadLaw(f"{folder} contains no submission", f"put each one into a folder, as NAME/{LAW_FILE}")
    return folders


def read_submission(folder: Path, limits: FileLimits, rig: str | None = None) -> Submission:
    """Read a submission; the file of its law, which may depend on a `rig`, is run in a fenced process."""
    if folder.is_symlink():
        raise BadLaw(f"{folder.name} is a link", "submit the folder itself")
    scripts, tables = _scripts_and_tables(folder)
    law = _law_of_submission(scripts)
    plans: list[Plan] = []
    gains: list[dict[str, float]] = []
    for path in tables:
        try:
            text = decode_text(read_file(path, TOML_BYTES))
            content = parse_toml(text)
        except OSError as error:
            raise PlanError(f"cannot read {path.name}: {error.strerror}", file_remedy(error)) from error
        except ValueError as error:
            raise PlanError(f"{path.name} is not TOML: {error}", "correct that line") from error
        if TABLE in content:
            gains.append(_gains_of_file(content, path))
        elif any(spec.name in content for spec in PARAMS):
            raise ParameterError(
                f"{path.name} sets parameters outside of [{TABLE}]", f"write the line [{TABLE}] above them"
            )
        else:
            plan = Plan.of_tables(content, text, path.name)
            _check_plan(plan)
            plans.append(plan)
    for kind, count in (("plans", len(plans)), ("parameter files", len(gains))):
        if count > 1:
            raise PlanError(f"{count} {kind} are in the folder", "submit one of them")
    if law is None and not plans and not gains:
        raise BadLaw(
            "the folder contains no law, plan or parameters",
            f"submit {LAW_FILE}, a plan, or a parameter file",
        )
    return Submission(
        name=folder.name,
        program=load_limited(law, limits, rig) if law is not None else None,
        plan=plans[0] if plans else None,
        gains=gains[0] if gains else {},
    )


def _scripts_and_tables(folder: Path) -> tuple[list[Path], list[Path]]:
    """Return the Python files and the TOML files of a submission, sorted by name."""
    entries = []
    for path in folder.iterdir():
        entries.append(path)
        if len(entries) > _MAX_FILES:
            raise BadLaw(f"the folder contains more than {_MAX_FILES} files", "submit fewer files")
    scripts = sorted(path for path in entries if path.suffix == ".py")
    tables = sorted(path for path in entries if path.suffix == ".toml")
    for path in sorted((*scripts, *tables)):
        # A link would lead to another student's work, and reading a pipe would not end.
        if path.is_symlink() or not path.is_file():
            raise BadLaw(f"{path.name} is not a plain file", "submit the file itself, not a link to it")
    return scripts, tables


def _law_of_submission(scripts: list[Path]) -> Path | None:
    """Return the control law of a submission: ``law.py``, or its only Python file; None without one."""
    law_file = next((path for path in scripts if path.name == LAW_FILE), None)
    if law_file is None and len(scripts) > 1:
        raise BadLaw(f"{len(scripts)} Python files, and none is {LAW_FILE}", f"name the law {LAW_FILE}")
    return law_file or (scripts[0] if scripts else None)


def _check_plan(plan: Plan) -> None:
    """Raise a PlanError if a plan is invalid or lasts longer than `LONGEST_PLAN_s`."""
    if plan.duration_s > LONGEST_PLAN_s:
        raise PlanError(
            f"{plan.source} lasts {plan.duration_s:.0f} s", f"shorten it to at most {LONGEST_PLAN_s:.0f} s"
        )
    plan.check()


def _gains_of_file(content: Mapping[str, Any], path: Path) -> dict[str, float]:
    """Return the gains of a parameter file; the rig keeps its own values of all other parameters."""
    # A ParameterError is raised if another parameter differs from its default.
    defaults = {spec.name: spec.default for spec in PARAMS}
    values = parameter_set(content, path).values
    gains = {name: value for name, value in values.items() if _GAINS.fullmatch(name) is not None}
    for name in sorted(values.keys() - gains.keys()):
        if values[name] != defaults[name]:
            raise ParameterError(
                f"{path.name} sets {name} to {values[name]:g}, which is not a gain", "remove this line"
            )
    return gains


def new_rig_log(folder: Path) -> Path:
    """Return an unused path for the log of a flight on the rig."""
    names = (RIG_LOG, *(f"{Path(RIG_LOG).stem}-{number}.mcap" for number in range(2, 10 * _MAX_FILES)))
    return next(path for path in (folder / MARKED / name for name in names) if not path.exists())


@contextmanager
def returned_files(folder: Path) -> Iterator[Path]:
    """Yield an empty temporary folder, which becomes the folder ``marked`` of a submission when the block
    ends.
    """
    # An existing ``marked`` is replaced, except for the files of flights on the rig. No file is written into
    # the existing folder, because it may be a link to another place.
    marked_folder = folder / MARKED
    _check_marked_folder(marked_folder)
    try:
        with tempfile.TemporaryDirectory(dir=folder, prefix=".marked-") as temporary_folder:
            yield Path(temporary_folder)
            if marked_folder.is_symlink() or marked_folder.is_file():
                marked_folder.unlink()
            elif marked_folder.exists():
                for path in marked_folder.iterdir():
                    if _RIG_FILES.fullmatch(path.name) and path.is_file() and not path.is_symlink():
                        path.rename(Path(temporary_folder) / path.name)
                shutil.rmtree(marked_folder)
            Path(temporary_folder).chmod(0o755)  # a temporary folder can be read by its owner only
            Path(temporary_folder).rename(marked_folder)
            # TemporaryDirectory needs a folder that it can remove.
            Path(temporary_folder).mkdir()
    except OSError as error:
        raise HeliError(
            f"cannot write {marked_folder}: {error.strerror or error}", file_remedy(error)
        ) from error


def _check_marked_folder(marked_folder: Path) -> None:
    """Refuse to replace a folder or a file that no earlier mark has written."""
    # A link is replaced without what it leads to, so that no link of a student leads the marks elsewhere.
    if marked_folder.is_symlink() or not marked_folder.exists() or FORCE.get():
        return
    is_own = marked_folder.is_dir() and all(
        _MARKED_FILES.fullmatch(path.name) and (path.name != "mark.json" or is_own_file(path))
        for path in marked_folder.iterdir()
    )
    if not is_own:
        raise ForeignFile(
            f"{marked_folder} exists, and heli-host did not write it", "rename it, or replace it with --force"
        )

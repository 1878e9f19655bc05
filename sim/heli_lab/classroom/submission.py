"""Submissions of a class: a folder per student with a control law, a plan or parameters."""

from __future__ import annotations

import re
import shutil
import tempfile
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from heli_host.declaration import PARAMS
from heli_host.errors import BadLaw, HeliError, ParameterError, PlanError, file_remedy
from heli_host.files import TOML_BYTES, parse_toml, read_file
from heli_host.fly.plan import Plan
from heli_host.law_program import LawProgram
from heli_host.parameter_file import TABLE, parameter_set

from heli_lab.law.files import load_limited
from heli_lab.law.limits import FileLimits

MARKED: Final = "marked"
"""Folder of a submission for what comes back: log, figure and mark."""
LAW_FILE: Final = "law.py"
RIG_LOG: Final = "rig.mcap"
_RIG_FILES: Final = re.compile(r"rig(-\d+)?\.(mcap|png)")
"""Files of flights on the rig in `MARKED`; they are kept when a submission is marked again."""
LONGEST_PLAN_s: Final = 120.0
"""Longest plan of a submission [s]. The built-in plans take up to 80 s; thirty plans of an hour would occupy
the rig for a day."""
_MAX_FILES: Final = 200
_GAINS: Final = re.compile(
    r"hover_(V|slope)|\w+_(kp|ki|kd|ff)|\w+_integral_max_(V|deg)|(elevation|pitch|travel)_filter_Hz"
    r"|pitch_setpoint_max_deg|differential_max_V|bumpless_s"
)
"""Parameters that a submission may change. The others describe the rig, are the limits that protect it, or
shape the setpoints by which it is judged."""


@dataclass(frozen=True)
class Submission:
    """Work of one student, read and checked.

    Parameters
    ----------
    name : str
        Name of its folder.
    program : LawProgram or None
        Its law; None for the board's own.
    plan : Plan or None
        Its plan; None for that of the class.
    gains : mapping of str to float
        Parameters of its file that tune the board's own law, by name.
    """

    name: str
    program: LawProgram | None = None
    plan: Plan | None = None
    gains: Mapping[str, float] = field(default_factory=dict)


def submissions_in(folder: Path) -> list[Path]:
    """Return the folders of the submissions, by name; hidden folders are left out.

    Raises
    ------
    BadLaw
        The folder is missing or has no submissions.
    """
    if not folder.is_dir():
        raise BadLaw(f"{folder} is not a folder", "give the folder that has one folder per submission")
    folders = sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))
    if not folders:
        raise BadLaw(f"{folder} contains no submission", f"put each one into a folder, as NAME/{LAW_FILE}")
    return folders


def read_submission(folder: Path, limits: FileLimits) -> Submission:
    """Read a submission; its law's code is run behind `limits`.

    Parameters
    ----------
    folder : Path
        Folder with ``law.py`` or a single Python file, a plan, parameters, or several of these.
    limits : FileLimits
        Limits of the law's file.

    Raises
    ------
    HeliError
        The submission is invalid; the message says why.
    """
    if folder.is_symlink():
        raise BadLaw(f"{folder.name} is a link", "submit the folder itself")
    scripts, tables = _files(folder)
    law = _law_among(scripts)
    plans: list[Plan] = []
    gains: list[dict[str, float]] = []
    for path in tables:
        try:
            text = read_file(path, TOML_BYTES).decode("utf-8")
            content = parse_toml(text)
        except OSError as error:
            raise PlanError(f"cannot read {path.name}: {error.strerror}", file_remedy(error)) from error
        except ValueError as error:
            raise PlanError(f"{path.name} is not TOML: {error}", "correct that line") from error
        if TABLE in content:
            gains.append(_gains(content, path))
        else:
            plans.append(_short(Plan.of_tables(content, text, path.name)))
    for kind, given in (("plans", plans), ("parameter files", gains)):
        if len(given) > 1:
            raise PlanError(f"{len(given)} {kind} are in the folder", "submit one of them")
    if law is None and not plans and not gains:
        raise BadLaw(
            "the folder contains no law, plan or parameters",
            f"submit {LAW_FILE}, a plan, or a parameter file",
        )
    return Submission(
        folder.name,
        load_limited(law, limits) if law is not None else None,
        plans[0] if plans else None,
        gains[0] if gains else {},
    )


def _files(folder: Path) -> tuple[list[Path], list[Path]]:
    """Python files and TOML files of a submission."""
    inside = []
    for path in folder.iterdir():
        inside.append(path)
        if len(inside) > _MAX_FILES:
            raise BadLaw(f"the folder contains more than {_MAX_FILES} files", "submit fewer files")
    known = sorted(path for path in inside if path.suffix in (".py", ".toml"))
    for path in known:
        # A link would lead to another student's work, and a pipe be waited for.
        if path.is_symlink() or not path.is_file():
            raise BadLaw(f"{path.name} is not a plain file", "submit the file itself, not a link to it")
    return [path for path in known if path.suffix == ".py"], [
        path for path in known if path.suffix == ".toml"
    ]


def _law_among(scripts: list[Path]) -> Path | None:
    named = next((path for path in scripts if path.name == LAW_FILE), None)
    if named is None and len(scripts) > 1:
        raise BadLaw(f"{len(scripts)} Python files, and none is {LAW_FILE}", f"name the law {LAW_FILE}")
    return named or (scripts[0] if scripts else None)


def _short(plan: Plan) -> Plan:
    """Return a plan that is short enough to be flown; otherwise raise a PlanError."""
    if plan.duration_s > LONGEST_PLAN_s:
        raise PlanError(
            f"{plan.source} lasts {plan.duration_s:.0f} s", f"shorten it to at most {LONGEST_PLAN_s:.0f} s"
        )
    plan.check()
    return plan


def _gains(content: Mapping[str, Any], path: Path) -> dict[str, float]:
    """Gains of a file; its other parameters have to be the defaults, and the rig keeps its values of them."""
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
    """Return a path for the log of a flight on the rig that no file has.

    Parameters
    ----------
    folder : Path
        Folder of the submission.
    """
    names = (RIG_LOG, *(f"{Path(RIG_LOG).stem}-{number}.mcap" for number in range(2, 10 * _MAX_FILES)))
    return next(path for path in (folder / MARKED / name for name in names) if not path.exists())


@contextmanager
def returned_files(folder: Path) -> Iterator[Path]:
    """Offer an empty folder, whose files are those of ``marked`` in the submission afterwards.

    The former ``marked`` is replaced, but for flights on the rig. Nothing is written through it, because it
    may be a link that leads elsewhere.

    Raises
    ------
    HeliError
        The folder cannot be written.
    """
    place = folder / MARKED
    try:
        with tempfile.TemporaryDirectory(dir=folder, prefix=".marked-") as temporary:
            yield Path(temporary)
            if place.is_symlink() or place.is_file():
                place.unlink()
            elif place.exists():
                for path in place.iterdir():
                    if _RIG_FILES.fullmatch(path.name) and path.is_file() and not path.is_symlink():
                        path.rename(Path(temporary) / path.name)
                shutil.rmtree(place)
            Path(temporary).chmod(0o755)
            Path(temporary).rename(place)
            Path(temporary).mkdir()  # for the end of the temporary folder
    except OSError as error:
        raise HeliError(f"cannot write {place}: {error.strerror or error}", file_remedy(error)) from error

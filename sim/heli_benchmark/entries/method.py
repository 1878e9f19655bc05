"""A method by its name: one of this package, or a function in a file."""

from __future__ import annotations

import hashlib
import importlib
import importlib.util
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any, Final

from heli_benchmark.errors import BenchmarkError

_METHODS: Final = Path(__file__).parents[1] / "methods"
_SHARED: Final = tuple(
    # A file comes before those that it imports.
    _METHODS / f"{stem}.py"
    for stem in ("equation_torques", "evidence", "terms", "motion")
)
_FUNCTION: Final = "diagnose"
_TRAIN: Final = "train"


@dataclass(frozen=True)
class MethodAddress:
    """Where a method is."""

    file: Path  # Python file that defines it
    function: str  # Name of the function that answers a case
    builtin: bool  # Whether the file belongs to this package

    @property
    def text(self) -> str:
        """Text from which `find_method` finds it in any folder."""
        return self.file.stem if self.builtin else f"{self.file}:{self.function}"

    @property
    def digest(self) -> str:
        """Digest of the code: of the file, and of what methods of this package share if it uses that."""
        content = self.file.read_bytes()
        for shared in _SHARED:
            if self.builtin and shared.stem.encode() in content:
                content += shared.read_bytes()
        return hashlib.sha256(content).hexdigest()


def builtin_methods() -> list[str]:
    """Return the names of the methods of this package: files with a function `diagnose`."""
    definition = f"\ndef {_FUNCTION}("
    return sorted(
        path.stem for path in _METHODS.glob("*.py") if definition in path.read_text(encoding="utf-8")
    )


def find_method(text: str) -> MethodAddress:
    """Find a method."""
    if text in builtin_methods():
        return MethodAddress(_METHODS / f"{text}.py", _FUNCTION, True)
    name, _, function = text.rpartition(":")
    if not name or not function.isidentifier():
        raise BenchmarkError(
            f"unknown method '{text}'", f"give FILE.py:FUNCTION, or one of {', '.join(builtin_methods())}"
        )
    file = Path(name)
    if not file.is_file():
        raise BenchmarkError(f"the file of the method, {name}, does not exist", "check the path")
    return MethodAddress(file.resolve(), function, False)


def load_function(method: MethodAddress) -> Callable[..., Any]:
    """Import a method, and return its function."""
    function = getattr(_import_module(method), method.function, None)
    if not callable(function):
        raise BenchmarkError(f"{method.file} has no function '{method.function}'", "give another name")
    return function  # type: ignore[no-any-return]


def load_train(method: MethodAddress) -> Callable[[Path], None] | None:
    """Import a method, and return its function `train`, or None if it has none."""
    return getattr(_import_module(method), _TRAIN, None)


def _import_module(method: MethodAddress) -> ModuleType:
    """Import the module of a method; a user's file may import its neighbours."""
    if method.builtin:
        return importlib.import_module(f"heli_benchmark.methods.{method.file.stem}")
    sys.path.insert(0, str(method.file.parent))
    spec = importlib.util.spec_from_file_location(f"entered_{method.file.stem}", method.file)
    if spec is None or spec.loader is None:
        raise BenchmarkError(f"{method.file} is not a Python file", "give FILE.py:FUNCTION")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module

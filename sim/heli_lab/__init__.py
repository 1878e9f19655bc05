"""The laboratory: identification, diagnosis of models, design of gains, and the reproduced paper.

`linearise` gives a rig as a `control.StateSpace`, for python-control or code of your own::

    import heli_lab

    plant = heli_lab.linearise("makki2024")

Arrays with three columns have elevation, pitch and travel, in this order; those with two, front and back.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from heli_lab.state_space import linearise

__all__ = ["linearise"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        from heli_lab.state_space import linearise

        return linearise
    raise AttributeError(f"module {__name__} has no attribute {name}")


def __dir__() -> list[str]:
    return sorted({*__all__, *(name for name in globals() if name.startswith("__"))})

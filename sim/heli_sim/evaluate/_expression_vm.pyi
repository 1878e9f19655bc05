from collections.abc import Sequence

from numpy import float64
from numpy.typing import NDArray

_Floats = NDArray[float64]

OPERATIONS: list[str]

# Arguments as sim/expression_vm says: values in the order in which they are computed, `a` and `b` the values
# that an operation takes.
class TableProgram:
    def __init__(
        self,
        operations: Sequence[int],
        a: Sequence[int],
        b: Sequence[int],
        constants: Sequence[float],
        widths: Sequence[int],
        wanted: Sequence[Sequence[int]],
    ) -> None: ...
    def evaluate(self, rows: Sequence[_Floats], shared: _Floats) -> list[_Floats]: ...

class CourseIntegrator:
    def __init__(
        self,
        operations: Sequence[int],
        a: Sequence[int],
        b: Sequence[int],
        constants: Sequence[float],
        widths: Sequence[int],
        rates: Sequence[int],
        resets: Sequence[int],
    ) -> None: ...
    def run(
        self,
        reference: Sequence[_Floats],
        t_s: _Floats,
        shared: _Floats,
        step_s: float,
        substeps: int,
        seen: int,
        start: _Floats,
    ) -> _Floats: ...

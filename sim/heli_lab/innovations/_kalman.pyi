from numpy import float64
from numpy.typing import NDArray

_Floats = NDArray[float64]

# All take transition, torque_input, measurement, measurement_variance, memory, torque_variance,
# initial_variance, drive and measured, shaped as sim/kalman/kalman.hpp says.
def filter(*arrays: _Floats) -> tuple[_Floats, list[float]]: ...
def track(*arrays: _Floats) -> tuple[_Floats, _Floats]: ...
def smooth(*arrays: _Floats) -> tuple[_Floats, _Floats]: ...

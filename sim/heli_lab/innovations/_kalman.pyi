from numpy import float64
from numpy.typing import NDArray

_Floats = NDArray[float64]

def filter(
    transition: _Floats,
    torque_input: _Floats,
    measurement: _Floats,
    measurement_variance: _Floats,
    memory: _Floats,
    torque_variance: _Floats,
    initial_variance: _Floats,
    drive: _Floats,
    measured: _Floats,
) -> tuple[_Floats, list[float]]: ...
def track(
    transition: _Floats,
    torque_input: _Floats,
    measurement: _Floats,
    measurement_variance: _Floats,
    memory: _Floats,
    torque_variance: _Floats,
    initial_variance: _Floats,
    drive: _Floats,
    measured: _Floats,
) -> tuple[_Floats, _Floats]: ...
def smooth(
    transition: _Floats,
    torque_input: _Floats,
    measurement: _Floats,
    measurement_variance: _Floats,
    memory: _Floats,
    torque_variance: _Floats,
    initial_variance: _Floats,
    drive: _Floats,
    measured: _Floats,
) -> tuple[_Floats, _Floats]: ...

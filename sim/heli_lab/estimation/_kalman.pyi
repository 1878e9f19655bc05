from numpy import float64
from numpy.typing import NDArray

_Floats = NDArray[float64]

# All take transition, part_input, measurement, measurement_variance, memory, disturbance_variance,
# initial_variance, drive and measured, shaped as sim/kalman/kalman.hpp says.
def filter(*arrays: _Floats) -> tuple[_Floats, list[float]]: ...
def track(*arrays: _Floats) -> tuple[_Floats, _Floats]: ...
def smooth(*arrays: _Floats) -> tuple[_Floats, _Floats]: ...

# The same with memory, disturbance_variance and the measurement variances' scale of several models.
def log_likelihoods(*arrays: _Floats) -> _Floats: ...

# transition, input and rates of each step, and how many steps make a block.
def over_blocks(transition: _Floats, input: _Floats, rates: _Floats, block: int) -> _Floats: ...

# The same: transition over each block, and what the rates of each of its steps alone have moved at
# its end, (block * blocks, states, columns), the first step of all blocks first.
def block_response(
    transition: _Floats, input: _Floats, rates: _Floats, block: int
) -> tuple[_Floats, _Floats]: ...

# Transition of the implicit midpoint rule, and what rates during a step move, by the rates' Jacobian.
def midpoint(jacobian: _Floats, step_s: float) -> tuple[_Floats, _Floats]: ...

"""The prediction error method along a measured course: likelihood of a model of a rig in weather."""

from heli_lab.innovations.course import Course, follow
from heli_lab.innovations.estimate import BLOCK_s, Estimate, Filtered, estimate
from heli_lab.innovations.evaluate import MapEvaluator, Trajectory
from heli_lab.innovations.linear import Linear, ModelFunctions
from heli_lab.innovations.unknowns import Unknowns
from heli_lab.innovations.weather import Weather

__all__ = [
    "BLOCK_s",
    "Course",
    "Estimate",
    "Filtered",
    "Linear",
    "MapEvaluator",
    "ModelFunctions",
    "Trajectory",
    "Unknowns",
    "Weather",
    "estimate",
    "follow",
]

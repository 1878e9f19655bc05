"""The prediction error method along a measured course: likelihood of a model of a rig in weather."""

from heli_lab.innovations.course import Course, follow
from heli_lab.innovations.estimate import Estimate, estimate
from heli_lab.innovations.evaluate import OWN_SUBSTEPS, AlongCourse, OwnStates, Trajectory
from heli_lab.innovations.filtered import Filtered
from heli_lab.innovations.linear import BLOCK_s, Derivatives, Linear, ModelFunctions, known_directions
from heli_lab.innovations.unknowns import Unknowns
from heli_lab.innovations.weather import Weather

__all__ = [
    "OWN_SUBSTEPS",
    "AlongCourse",
    "BLOCK_s",
    "Course",
    "Derivatives",
    "Estimate",
    "Filtered",
    "Linear",
    "ModelFunctions",
    "OwnStates",
    "Trajectory",
    "Unknowns",
    "Weather",
    "estimate",
    "follow",
    "known_directions",
]

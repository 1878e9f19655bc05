"""The prediction error method along a measured course: likelihood of a model of a rig in weather."""

from heli_lab.innovations.disturbances import DisturbanceModel
from heli_lab.innovations.estimate import Estimate, estimate
from heli_lab.innovations.evaluate import EFFECT_SUBSTEPS, AlongTrajectory, EffectStates, Trajectory
from heli_lab.innovations.innovations_model import InnovationsModel
from heli_lab.innovations.linearised_flight import (
    BLOCK_s,
    Derivatives,
    LinearisedFlight,
    ModelFunctions,
    known_directions,
)
from heli_lab.innovations.parameter_vector import ParameterVector
from heli_lab.innovations.reference_trajectory import ReferenceTrajectory, kinematic_filter

__all__ = [
    "EFFECT_SUBSTEPS",
    "AlongTrajectory",
    "BLOCK_s",
    "Derivatives",
    "DisturbanceModel",
    "EffectStates",
    "Estimate",
    "InnovationsModel",
    "LinearisedFlight",
    "ModelFunctions",
    "ParameterVector",
    "ReferenceTrajectory",
    "Trajectory",
    "estimate",
    "kinematic_filter",
    "known_directions",
]

"""Parameters, states and disturbances of a grey-box model, estimated from inputs and outputs."""

from heli_lab.fit.estimation.auxiliary_residuals import AuxiliaryResiduals, ShockScores, auxiliary_residuals
from heli_lab.fit.estimation.disturbances import DisturbanceModel, GainDisturbance
from heli_lab.fit.estimation.estimate import Estimate, estimate, estimate_disturbances
from heli_lab.fit.estimation.grey_box import ActingInputs, GreyBoxModel, Recording
from heli_lab.fit.estimation.innovations import Innovations
from heli_lab.fit.estimation.innovations_model import InnovationsModel
from heli_lab.fit.estimation.linearised_flight import BLOCK_s, Derivatives, LinearisedFlight
from heli_lab.fit.estimation.model_functions import ModelFunctions
from heli_lab.fit.estimation.parameter_vector import FreeParameter, NormalPrior, ParameterVector
from heli_lab.fit.estimation.reference_trajectory import KinematicModel, ReferenceTrajectory, kinematic_filter
from heli_lab.fit.estimation.smoothing import refiltered, smoothed_disturbances
from heli_lab.fit.estimation.trajectory_functions import (
    EFFECT_SUBSTEPS,
    AlongTrajectory,
    EffectStates,
    Trajectory,
)

__all__ = [
    "EFFECT_SUBSTEPS",
    "ActingInputs",
    "AlongTrajectory",
    "AuxiliaryResiduals",
    "BLOCK_s",
    "Derivatives",
    "DisturbanceModel",
    "EffectStates",
    "Estimate",
    "FreeParameter",
    "GainDisturbance",
    "GreyBoxModel",
    "Innovations",
    "InnovationsModel",
    "KinematicModel",
    "LinearisedFlight",
    "ModelFunctions",
    "NormalPrior",
    "ParameterVector",
    "Recording",
    "ReferenceTrajectory",
    "ShockScores",
    "Trajectory",
    "auxiliary_residuals",
    "estimate",
    "estimate_disturbances",
    "kinematic_filter",
    "refiltered",
    "smoothed_disturbances",
]

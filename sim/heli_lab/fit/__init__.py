"""Estimation of parameters, states and disturbances from flights: a core for any machine, applied to the rig.

The core is the prediction error method in innovations form, with priors;
`docs/explanation/how-diagnosis-works.md` derives its equations. A `GreyBoxModel` describes states, inputs,
outputs, parameters and disturbances of a machine. These modules contain nothing about
the helicopter: `parameters`, `grey_box`, `model_functions`, `reference_trajectory`, `linearised_flight`,
`innovations`, `normal_equations` and `estimator`. `flight_model` describes the helicopter to them.

`identify` fits a rig by multiple shooting: it simulates windows of flights from free initial states. The
noise is the encoders' quantisation, and the tolerances of the rig are priors.

Does not belong here: equations of motion (`heli_sim.model`), rig parameters (`heli_sim.rig`), conclusions
from a likelihood (`heli_lab.explain`).
"""

from heli_sim.evaluate.trajectories import EFFECT_SUBSTEPS, AlongTrajectory, EffectStates, Trajectory

from heli_lab.fit.estimator import Estimate, estimate, estimate_disturbances
from heli_lab.fit.grey_box import ActingInputs, DisturbanceModel, GainDisturbance, GreyBoxModel, Recording
from heli_lab.fit.identification import FreeRunErrors, Identification, Trace, check, identify, trace, validate
from heli_lab.fit.innovations import (
    AuxiliaryResiduals,
    Innovations,
    InnovationsModel,
    ShockScores,
    SmoothedDisturbances,
    auxiliary_residuals,
    refiltered,
    smoothed_disturbances,
)
from heli_lab.fit.linearised_flight import BLOCK_s, Derivatives, LinearisedFlight
from heli_lab.fit.model_functions import ModelFunctions
from heli_lab.fit.parameters import FreeParameter, NormalPrior, ParameterVector
from heli_lab.fit.problem import Budget, Fit, FitProgress, Problem
from heli_lab.fit.records import Record, prepare
from heli_lab.fit.reference_trajectory import KinematicModel, ReferenceTrajectory, kinematic_filter
from heli_lab.fit.shooting import solve
from heli_lab.fit.uncertainty import Combination, combinations, uninformed_parameters

__all__ = [
    "EFFECT_SUBSTEPS",
    "ActingInputs",
    "AlongTrajectory",
    "AuxiliaryResiduals",
    "BLOCK_s",
    "Budget",
    "Combination",
    "Derivatives",
    "DisturbanceModel",
    "EffectStates",
    "Estimate",
    "Fit",
    "FitProgress",
    "FreeParameter",
    "FreeRunErrors",
    "GainDisturbance",
    "GreyBoxModel",
    "Identification",
    "Innovations",
    "InnovationsModel",
    "KinematicModel",
    "LinearisedFlight",
    "ModelFunctions",
    "NormalPrior",
    "ParameterVector",
    "Problem",
    "Record",
    "Recording",
    "ReferenceTrajectory",
    "ShockScores",
    "SmoothedDisturbances",
    "Trace",
    "Trajectory",
    "auxiliary_residuals",
    "check",
    "combinations",
    "estimate",
    "estimate_disturbances",
    "identify",
    "kinematic_filter",
    "prepare",
    "refiltered",
    "smoothed_disturbances",
    "solve",
    "trace",
    "uninformed_parameters",
    "validate",
]

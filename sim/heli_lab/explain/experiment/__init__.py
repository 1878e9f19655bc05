"""The next experiment: plans that discriminate hypotheses or make effects detectable, tried in simulation."""

from heli_lab.explain.experiment.design import ExperimentDesign, compose_experiment
from heli_lab.explain.experiment.proposal import propose_experiment

__all__ = ["ExperimentDesign", "compose_experiment", "propose_experiment"]

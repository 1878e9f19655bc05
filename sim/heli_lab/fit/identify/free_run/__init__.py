"""Free runs of a model over many windows, with exact derivatives: the inner loop of every fit."""

from heli_lab.fit.identify.free_run.choice import kernel
from heli_lab.fit.identify.free_run.functions import Functions, Inputs, VoltageDerivative
from heli_lab.fit.identify.free_run.interface import Kernel

__all__ = ["Functions", "Inputs", "Kernel", "VoltageDerivative", "kernel"]

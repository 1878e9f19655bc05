"""Runs of methods on a Dask cluster, by the campaign engine of the laboratory."""

from heli_benchmark.cluster.run import run_on_cluster

__all__ = ["run_on_cluster"]

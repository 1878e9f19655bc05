"""Thousands of simulated flights, fits, diagnoses or gain checks, on one machine or many.

The result of a case depends on its settings and the code only, and is stored under a digest of both. If a
campaign is interrupted, the same command continues it.
"""

from heli_lab.apps.campaign.cases import Campaign, Case, JobResult
from heli_lab.apps.campaign.run import campaign_results, run_campaign
from heli_lab.apps.campaign.store import Store

__all__ = ["Campaign", "Case", "JobResult", "Store", "campaign_results", "run_campaign"]

"""Thousands of simulated flights, fits, diagnoses or gain checks, on one machine or many."""

from __future__ import annotations

from heli_lab.apps.campaign.campaign import Campaign
from heli_lab.apps.campaign.case import Case, JobResult
from heli_lab.apps.campaign.results import campaign_results
from heli_lab.apps.campaign.run import run_campaign
from heli_lab.apps.campaign.store import Store

__all__ = ["Campaign", "Case", "JobResult", "Store", "campaign_results", "run_campaign"]

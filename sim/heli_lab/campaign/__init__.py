"""Thousands of simulated flights, fits, diagnoses or gain checks, on one machine or many."""

from __future__ import annotations

from heli_lab.campaign.case import Answer, Case
from heli_lab.campaign.run import Campaign, run_campaign
from heli_lab.campaign.store import Store

__all__ = ["Answer", "Campaign", "Case", "Store", "run_campaign"]

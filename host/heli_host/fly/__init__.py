"""Flight plans, and flying them."""

from __future__ import annotations

from heli_host.fly.plan import Plan, load_plan, plan_names

__all__ = ["Plan", "load_plan", "plan_names"]

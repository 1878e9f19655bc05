"""Flight plans, control laws in Python, and flying them.

`load_plan` reads a plan, `runner.fly` flies it, and `recorder.Recorder` writes the log. `pilot.Pilot` runs
the flight in the thread of its caller: its monitor reports that the flight must end, and why; then no more
setpoints are sent, and the arm comes down. A second Ctrl-C switches the motors off in the air.

Does not belong here: bytes of the link, drawing, anything of the command line.
"""

from __future__ import annotations

from heli_host.board.law_flight import ControlLaw, ControllerReport, Following, run_controller
from heli_host.fly.plan import Plan, load_plan, plan_names

__all__ = ["ControlLaw", "ControllerReport", "Following", "Plan", "load_plan", "plan_names", "run_controller"]

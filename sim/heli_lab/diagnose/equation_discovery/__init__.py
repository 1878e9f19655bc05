"""The law of what is on no list: its equation, where it matters, and an effect file that flies."""

from heli_lab.diagnose.equation_discovery.discover import discover
from heli_lab.diagnose.equation_discovery.discovery import Discovery
from heli_lab.diagnose.equation_discovery.law import NAME
from heli_lab.diagnose.equation_discovery.proposal import ProposedLaw, propose_law

__all__ = ["NAME", "Discovery", "ProposedLaw", "discover", "propose_law"]

"""The law of what is on no list: its equation, where it matters, and an effect file that flies."""

from heli_lab.diagnose.equation_discovery.discover import discover
from heli_lab.diagnose.equation_discovery.discovery import Discovery
from heli_lab.diagnose.equation_discovery.equation import NAME
from heli_lab.diagnose.equation_discovery.proposal import ProposedTerm, propose_term

__all__ = ["NAME", "Discovery", "ProposedTerm", "discover", "propose_term"]

"""Report of an identification: an HTML page with figures."""

from heli_lab.report.identification.page import verdict, write_identification_report

__all__ = ["verdict", "write_identification_report"]

"""Flights as files and arrays: logs, flights, tables of other programs."""

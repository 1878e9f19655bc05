"""Change detection: a twin compares a rig with its model, raises an alarm, and ranks possible changes."""

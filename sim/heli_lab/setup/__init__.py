"""From a new rig to a described one: calibration, and the columns of foreign logs."""

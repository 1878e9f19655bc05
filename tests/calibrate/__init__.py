"""Claims about the calibration of a rig on its bench."""

"""Calibration of a rig on its bench: encoders by hand movements, motors by short pulses."""

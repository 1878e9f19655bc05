"""Whether a rig still flies as its model: the twin, and the scales of its encoders."""

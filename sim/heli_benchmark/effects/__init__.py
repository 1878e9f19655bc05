"""Effects that can be hidden in a rig, listed or not, and disturbances."""

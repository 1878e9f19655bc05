"""What a scale, a ruler and a stopwatch tell of a rig."""

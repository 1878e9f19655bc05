"""Control laws as data, gains designed from a rig, and flights with both."""

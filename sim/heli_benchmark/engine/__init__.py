"""The rig as bodies and joints in MuJoCo, and what it did at each step."""

"""A twin that flies beside a rig, and says when the rig is no longer the rig, and what changed."""

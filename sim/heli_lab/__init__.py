"""The laboratory: what flights tell about a rig, what a model lacks, gains, and the paper done again."""

"""The next experiment: plans that discriminate hypotheses or make effects detectable, tried in simulation."""

"""Search for the causes of what a model lacks: candidates, score tests, refits, stepwise selection."""

"""Parameters, states and disturbances of a model, estimated from flights."""

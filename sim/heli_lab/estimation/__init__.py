"""Parameters, states and disturbances of a state-space model, estimated from measured inputs and outputs."""

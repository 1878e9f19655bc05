"""A connected board: its state, flying it, its parameters and laws."""

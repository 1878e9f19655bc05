"""Columns as signals with scales, and how well the equations of motion explain an assignment of them."""

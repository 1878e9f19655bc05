"""Discovery of what the catalogue lacks: equations, spline terms as curves, and the missing torque along
flights.
"""

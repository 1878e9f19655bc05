"""Flights of the MuJoCo rig: by the flight code, and by other controllers."""

"""Claims about gains.

The promises of the design are flown here, by the flight code, on the multibody rig with encoders, drivers
and the lag of the rotors. `monte_carlo.py` flies the defaults on random rigs, as a campaign.
"""

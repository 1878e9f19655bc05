"""Claims about gains.

The promises of the design are flown here, by the flight code, on the multibody rig with encoders, drivers
and the lag of the rotors. `test_verb.py` flies what `heli-host tune` writes for rigs of other types.
`monte_carlo.py` flies the defaults on random rigs, as a campaign. `pilot.py` is a host without a session,
some hundred times real time, so that a claim may be about two hundred rigs.
"""

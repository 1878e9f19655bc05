"""The host under stress: campaigns with printed seeds, of which the ordinary suite runs a small share.

``make soak`` keeps a live page busy for an hour; ``make attack`` runs all random attacks of the tests behind
one command. `serial_stories` gives a flight over a pseudo-terminal the trouble that a serial port can have.
"""

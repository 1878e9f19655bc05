"""A connected board: `heli.Heli` is the whole interface of a helicopter.

It is composed of parts: reading (`telemetry`), commands of a flight (`flying`), the end of a flight
(`landing`), commands without a control loop (`bench`), control laws of others (`law_flight`), and the board's
`parameters`.
"""

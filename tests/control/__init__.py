"""Claims about the control law, the mixer, the rate filter and the excitation.

The witness is `reference.py`, the same law written a second time in double precision. Its sources are
equations 32 to 34 of the paper and the limits in `firmware/link.toml`, never the C++ code. In
`test_seam.py` the core flies any law through the interface alone, and trusts none.
"""

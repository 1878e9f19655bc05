"""Claims about the control law, the mixer, the rate filter and the excitation.

The witness is `reference.py`: the same law written a second time, slowly, in double precision from the
equations of the paper (32-34) and the limits as `firmware/link.toml` words them; never from the C++.

`test_seam.py`: the core flies any law through the interface alone, here one that is told its voltages, and
trusts none.
"""

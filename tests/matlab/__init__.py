"""The class for MATLAB, in Octave.

`docs/matlab/Heli.m` runs in Octave with its package instrument-control, because MATLAB is not available
here. Without Octave these tests skip with that reason. `test_matlab.py` compares its frames with those of
the host, and flies a simulated board over TCP with the scripts `frames.m` and `flies.m`.
"""

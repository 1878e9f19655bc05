"""The class for MATLAB, in Octave.

No MATLAB is here: `docs/matlab/Heli.m` runs in Octave, where Octave and its package instrument-control are;
else these tests skip and say so.

`test_matlab.py`: its frames are those of the host, and it flies a simulated board over TCP. `frames.m`,
`flies.m`: what Octave does for that.
"""

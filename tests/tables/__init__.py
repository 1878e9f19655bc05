"""Claims about tables that other programs wrote.

Files of others, made here by other programs' writers: the csv module, scipy and h5py for MATLAB, pyarrow,
openpyxl, rosbags.
"""

"""Claims about several rigs of one type, and several flights of one rig.

Does not belong here: single diagnoses (`../diagnose`).
"""

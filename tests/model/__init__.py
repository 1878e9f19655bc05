"""Claims about what is made from a model's symbols, and about effects.

Claims about what is made from a model's symbols (trim, Jacobians, linearisation, formulas) and about the
equations as the paper prints them. The models themselves are held against witnesses in `tests/plant/`.

Effects: `test_effects.py` (neutral values, size, derivatives, energy, order), `test_rotor_effects.py`
(lags, supply, momentum, nested effects), `test_effects_mujoco.py` (MuJoCo makes the same effect by its own
means), `test_effect_files.py` (command line, rig files, users' files, the documents),
`test_effects_flown.py` (flown by the simulated board, found in its log; `flown.py` does all).
"""

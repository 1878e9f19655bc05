"""Claims about effects, and about everything that is derived from the symbols of a model.

Trim, Jacobians, linearisation, formulas, and the equations as the paper prints them are derived from
symbols. `tests/plant` compares the models themselves with witnesses. Claims about effects:

| file | claims |
|---|---|
| `test_effects.py` | neutral values, size, derivatives, energy, order |
| `test_rotor_effects.py` | lags, supply, momentum, nested effects |
| `test_effects_mujoco.py` | MuJoCo makes the same effect by its own means |
| `test_effect_files.py` | command line, rig files, files of users, documents |
| `test_effects_flown.py` | an effect of the simulated board is identified from its log; `flown.py` does all |
"""

"""Claims about effects, and about everything that is derived from the symbols of a model.

Trim, Jacobians, linearisation, formulas, and the equations as the paper prints them are derived from
symbols. `test_models.py` and `test_plant.py` compare models and plant with witnesses. Claims about effects:

| file | claims |
|---|---|
| `test_effects.py` | neutral values, size, derivatives, energy, order; lags, supply, momentum |
| `test_effects_mujoco.py` | MuJoCo makes the same effect by its own means |
| `test_effect_files.py` | command line, rig files, files of users, documents |
| `flown.py` | an effect of the simulated board is identified from its log |
"""

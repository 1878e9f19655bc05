"""The Due's firmware on the emulated board: behaviour, safety, timing, size and cost.

`desk.py` is the board with arm and host, `built.py` the linked firmware, `cost.py` counts instructions
(``python -m tests.firmware.cost ELF``). Mistakes that these tests must notice are in
``tests/mutants/mistakes.toml``.
"""

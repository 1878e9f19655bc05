"""The flight code on the emulated Due, as a board that a simulated world flies."""

"""The flight code on the emulated Due, as a board for a simulated world."""

"""The verbs that simulate a board and look at rigs, one module each."""

"""One case from its flights to its row, and one module for each question about the diagnosis."""

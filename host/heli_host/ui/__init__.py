"""Shows a board to people and takes their commands: command line, dashboard, Foxglove."""

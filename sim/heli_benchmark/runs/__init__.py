"""One case from its flights to its row, and the commands for unlisted equations and removed effects."""

"""Known effects, hidden in real flights."""

"""From firmware/link.toml to what board, host and people read of it."""

"""Writing flights to disk and reading them; see the README in this folder."""

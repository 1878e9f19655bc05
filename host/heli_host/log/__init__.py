"""A flight on disk, and back; see the README beside this file."""

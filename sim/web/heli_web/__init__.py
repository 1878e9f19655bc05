"""The page that flies in a browser: how it is built."""

"""The page that flies in a browser: the bytes of its boards, its small host, its logs, and the page in Chromium."""

"""The page that flies in a browser: bytes of its boards, its small host, its logs, the page in Chromium."""

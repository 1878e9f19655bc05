"""Claims about the dashboard: its server, its sockets, and the page in a browser."""

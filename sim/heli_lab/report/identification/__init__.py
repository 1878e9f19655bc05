"""Report of an identification: an HTML page with figures."""

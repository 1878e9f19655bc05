"""The verb that builds the page."""

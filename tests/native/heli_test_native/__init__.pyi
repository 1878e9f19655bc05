"""Types of the extension that tests look into the flight code with; source in tests/native."""

"""Methods that find hidden causes, each an adaptor with a function `diagnose`."""

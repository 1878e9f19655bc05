"""Report of a diagnosis: sentences, JSON, figures and pages."""

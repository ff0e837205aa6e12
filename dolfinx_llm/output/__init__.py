"""Values, files and pictures."""

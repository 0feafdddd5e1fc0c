"""Report: scores of many cells in one tidy table."""

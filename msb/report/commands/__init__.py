"""The commands that make tables and pages of results, and of what methods declare."""

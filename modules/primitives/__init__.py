"""What several image modules need."""

"""One file per code that a check can report."""

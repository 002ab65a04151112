"""Checks of a rule base: errors keep it from loading; warnings are for its author."""

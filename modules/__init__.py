"""Image modules of terrex: measurement, correction, matching, reconstruction and simulation; they know no rules."""

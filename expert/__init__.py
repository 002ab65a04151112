"""terrex: a rule-based expert system that reconstructs 3D terrain from stereo pairs and explains every decision."""

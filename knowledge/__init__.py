"""The shipped knowledge: rules.yaml and the cases that prove each rule."""

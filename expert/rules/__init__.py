"""The rule language: its models, its loader, its checks and its cases; no engine in here."""

"""Claims about accuracy and speed, each with the command that checks it."""

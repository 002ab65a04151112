"""The error of unreadable and unwritable files."""


class FormatError(ValueError):
    """A file cannot be read or written; the sentence names the file, the value found, the limit and the remedy."""

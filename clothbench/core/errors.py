"""The one exception a user can cause: a single line that says what to do."""


class ClothbenchError(Exception):
    """Wrong use or bad input. Shown as one line; the command ends with exit code 2."""

"""What a user is told in one line: the commands print it and end with exit code 2."""


class BadInput(Exception):
    """What the user gave cannot be used; the message is one line that names the culprit and the mend."""

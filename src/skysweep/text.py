"""Text from outside: file names, class names, what other programs say."""


def printable(text: str) -> str:
    """The text without what steers a terminal, breaks a line or is no XML, written as escapes."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)

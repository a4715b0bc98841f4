"""Text from outside (file names, class names, what other programs say), and shares as text."""


def printable(text: str) -> str:
    """The text without what steers a terminal, breaks a line or is no XML, written as escapes."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def percent(share: float) -> str:
    """A share of 1 in percent that rounding makes neither none nor all: "0.4%", "37%", "all but 0.4%"."""
    if 0.995 < share < 1.0:
        return f"all but {_small_percent(1.0 - share)}"
    return _small_percent(share) if 0.0 < share < 0.005 else f"{share:.0%}"


def _small_percent(share: float) -> str:
    return f"{100.0 * share:.1g}%" if share >= 1e-6 else "less than 0.0001%"

"""What all tests have in common."""

from hypothesis import settings

settings.register_profile("any machine", deadline=None)  # a busy one takes long for an example
settings.load_profile("any machine")

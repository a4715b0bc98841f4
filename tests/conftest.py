"""What all tests have in common."""

import signal

from hypothesis import settings

settings.register_profile("any machine", deadline=None)  # a busy one takes long for an example
settings.load_profile("any machine")
signal.signal(signal.SIGINT, signal.default_int_handler)  # in the background of a script it is ignored

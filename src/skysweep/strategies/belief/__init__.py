"""Search by belief: a probability for every candidate, and descents only where they pay."""

"""What a team's own pictures tell: how good a detector is on them, and what it found in those of a flight."""

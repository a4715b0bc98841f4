"""A flight of a team's own, told from its pictures: what a detector finds in them, as a run folder."""

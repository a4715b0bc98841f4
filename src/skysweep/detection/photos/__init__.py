"""A team's own pictures: where, when and through which lens they were taken."""

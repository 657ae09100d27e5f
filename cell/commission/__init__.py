"""Tools of the person who sets a cell up: one look without motion, and what follows it."""

"""A study: many campaigns recorded, scored, taken apart and reported by one command."""

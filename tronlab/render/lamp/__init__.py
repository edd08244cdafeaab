"""What a lamp that stands still lights: worked out once, for every sample of the terrain."""

"""The simulated laboratory: one seeded world, and devices that are views of it."""

"""Mitsuba 3, with our rays, our lamp and the photometric functions written a second time."""

"""GigE Vision camera: driver for any GenTL producer, our own producer, and a simulated camera."""

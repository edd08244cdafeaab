"""Where the camera sits on the T-MAC."""

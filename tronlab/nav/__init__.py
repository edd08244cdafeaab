"""Navigation cores: from an image to the pose of the camera, by landmarks of a database."""

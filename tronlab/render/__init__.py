"""What a camera sees of a terrain: image, depth, 3-D points and the mask of the model."""

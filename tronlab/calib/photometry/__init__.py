"""How the paint of the model reflects light, from recorded images and renderings of them."""

"""Charts and motions as values, where their parts stand, and the renderers that draw them."""

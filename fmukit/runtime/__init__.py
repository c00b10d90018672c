"""How a model goes from one communication point to the next."""

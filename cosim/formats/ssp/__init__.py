"""Systems from and to .ssp files (System Structure and Parameterization 1.0)."""

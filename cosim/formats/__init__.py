"""Systems in the formats of other tools."""

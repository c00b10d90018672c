"""What a model declares: variables with quantity, start, bounds and meaning."""

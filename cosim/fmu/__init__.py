"""FMUs as they are loaded and called."""

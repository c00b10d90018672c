"""The questions about a drive of many parts."""

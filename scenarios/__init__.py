"""One module, one question: `python -m scenarios list`."""

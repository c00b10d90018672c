"""The FMU file: description, page, reference results, archive."""

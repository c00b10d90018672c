"""The site of the project: guides, machines, questions with their live pages, reference, search."""

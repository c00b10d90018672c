"""The page of an answer: curves, maps, mechanisms in motion, in one file of HTML."""

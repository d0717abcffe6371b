"""Flight conditions as others record them: their names and units, what follows from what is there, what cannot be."""

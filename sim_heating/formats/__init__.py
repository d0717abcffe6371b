"""The catalogue of file formats: which files the program reads and writes, their schemas, and their keys."""

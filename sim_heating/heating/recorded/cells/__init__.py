"""Cells of tables in text: their layout, numbers and clocks, decided once over a whole file."""

"""Tables as loggers, recorders and spreadsheets write them, read by a stated layout.

Text -> layout (separator, rows of names and units, decimal and thousands signs, order of dates, clock, lost codes,
trailer), decided once over the whole file -> cells -> numbers. What a layout leaves open is refused with one cell and
the option that states it.
"""

"""The sixteen figures of the founding paper, drawn over flights: diagrams, sections, histories, ratios, a trend, maps.

"Trends in Shuttle Entry Heating from the Correlation of Flight Test Maneuvers". Each figure has the paper's number in
its title and its data as CSV; what is drawn is of the flights given, found by control point, kind of manoeuvre and
speed.
"""

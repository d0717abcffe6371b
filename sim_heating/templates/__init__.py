"""Templates: records, vehicles, scenarios, effects and studies written from a few numbers, for `sim-heating new`.

What is written is commented, validates, and runs in the command that it is for. Numbers come from the user, from the
material library, or are defaults of the models; each guess is reported with its reason.
"""

"""Design of manoeuvres: predicted bounds of the parameters before a flight, and the most informative manoeuvre."""

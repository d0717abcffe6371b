"""Facts about a result, from which its credibility follows: its inputs, the equations it uses, what is uncertain."""

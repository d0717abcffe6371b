"""What came: the journal of a link, and the flight records that it closes as."""
